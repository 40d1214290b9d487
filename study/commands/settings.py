"""Settings from YAML files and flags. Every error is one line.

Flags override the file in any order. Plugins are imported before the other settings are read, since
a model of a plugin may have settings.
"""

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

from study.common.errors import BadInput, nearest, shown
from study.common.plugins import import_plugins
from study.config import strict_yaml
from study.config.recorded import register_recorded
from study.config.settings import Config
from study.config.tree import config_of, flatten, known_settings, unknown_setting, values_of
from study.config.values import allowed, check_setting, takes_text
from study.results.folder import stored_settings

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
DEFAULT = CONFIGS / "quick.yaml"
HELP = ("-h", "--help")

Texts = Mapping[str, str | None]
"""The text after the flag of a setting, by dotted name; None without text."""


def split(
    arguments: Sequence[str], others: Collection[str], switches: Collection[str] = ()
) -> tuple[dict[str, str | None], list[str]]:
    """Split a command line into flags of settings and other arguments.

    Args:
        arguments: the command line after the command.
        others: flags that are not settings, such as ``--out``.
        switches: those that have no value, such as ``--follow``.

    Returns:
        the text of each setting (the last one counts), and the other arguments.

    Raises:
        BadInput: the value of another flag is missing.
    """
    texts: dict[str, str | None] = {}
    rest: list[str] = []
    waiting = list(arguments)
    while waiting:
        argument = waiting.pop(0)
        flag, equals, text = argument.partition("=")
        if not flag.startswith("--") or flag in HELP or argument in switches:
            rest.append(argument)
            continue
        value = text if equals else None
        if value is None and waiting and not waiting[0].startswith("--"):
            value = waiting.pop(0)
        if flag not in others:
            texts[flag[2:]] = value
        elif value is None:
            raise _no_value(flag)
        else:
            rest.append(f"{flag}={value}")
    return texts, rest


def read_config(
    file: str | None, texts: Texts, out: Path | None = None, part: str | None = None
) -> Config:
    """The checked settings of a file and of flags, after importing the plugins.

    Args:
        file: a YAML file. None for the settings of the study in `out`, or for
            ``configs/quick.yaml`` if `out` has no study.
        texts: of the flags.
        out: a results folder.
        part: a part of the file that is no setting, see `read_part`.

    Raises:
        BadInput: a setting is unknown or has a value that is not allowed.
    """
    stored = stored_settings(out) if file is None and out is not None else None
    if stored is None:
        path = Path(file) if file is not None else DEFAULT
        content = {key: value for key, value in _read_file(path).items() if key != part}
    else:
        path, content = stored
    import_plugins_of(content, texts)
    register_recorded(content)
    return config_of(flatten(content, f" in {path}") | _values(texts))


def read_part(file: str | None, part: str) -> Any:
    """The part of a file of settings that is no setting; None if the file does not have it."""
    return _read_file(Path(file) if file is not None else DEFAULT).get(part)


def import_plugins_of(content: Mapping[str, Any], texts: Texts) -> None:
    """Import the plugins that a file names, or a flag that replaces the entry in the file.

    Raises:
        BadInput: a plugin cannot be imported.
    """
    plugins = content.get("plugins", ())
    if "plugins" in texts:
        plugins = _values({"plugins": texts["plugins"]})["plugins"]
    import_plugins(check_setting("plugins", tuple[str, ...], plugins, (), {}))


def change(config: Config, flags: Sequence[str]) -> Config:
    """Settings with some of them changed.

    Args:
        config: the settings.
        flags: the changes as flags, such as ``--vae.latent_size=2``.

    Raises:
        BadInput: a setting is unknown or has a value that is not allowed.
    """
    texts, rest = split(flags, ())
    if rest:
        raise BadInput(f"got {shown(rest[0])}; a change is written SETTING=VALUE")
    return config_of(values_of(config) | _values(texts))


def _values(texts: Texts) -> dict[str, Any]:
    """The values of the flags of settings, by dotted name."""
    settings = known_settings()
    values = {}
    for key, text in texts.items():
        if key not in settings:
            raise unknown_setting(key)
        if text is None:
            raise _no_value(f"--{key}")
        values[key] = _value(key, settings[key].kind, text)
    return values


def _value(key: str, kind: Any, text: str) -> Any:
    if takes_text(kind):
        return text
    try:
        return strict_yaml.parse(text)
    except strict_yaml.NotYaml:
        raise BadInput(f"{key}: got {shown(text)}; it must be {allowed(kind)}") from None


def _no_value(flag: str) -> BadInput:
    return BadInput(f"{flag[2:]}: its value is missing; write {flag} VALUE")


def _read_file(path: Path) -> dict[str, Any]:
    """The sections of settings in a YAML file."""
    try:
        content = strict_yaml.parse(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        files = sorted(str(file) for file in path.parent.glob("*.yaml"))
        hint = nearest(str(path), files) if files else f"{path.parent} has no YAML file"
        raise BadInput(f"--config: no file '{path}'; {hint}") from None
    except UnicodeDecodeError as error:
        raise BadInput(f"--config: '{path}' is not UTF-8: {error.reason}") from None
    except OSError as error:
        raise BadInput(f"--config: cannot read '{path}': {error.strerror}") from None
    except strict_yaml.NotYaml as error:
        raise BadInput(f"--config: '{path}' is not YAML: {error}") from None
    if not isinstance(content, dict):
        raise BadInput(f"--config: '{path}' holds no settings; write lines such as 'name: quick'")
    return content
