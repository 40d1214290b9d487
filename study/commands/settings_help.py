"""The list of all settings at the end of ``all --help``."""

from argparse import ArgumentParser
from typing import Any

from study.config.tree import TOP, Setting, help_texts, known_settings, section_classes
from study.config.values import allowed


def add_settings(parser: ArgumentParser) -> None:
    """Add every setting to the help of a parser, in a group for each section."""
    texts = help_texts()
    all_settings = known_settings()
    for name, settings in section_classes().items():
        summary = (settings.__doc__ or "").strip().partition("\n")[0].rstrip(".")
        group = parser.add_argument_group(f"{name}: {summary}" if name != TOP else summary)
        for key, setting in all_settings.items():
            if setting.section == name:
                text = f"{texts[key]} [{_allowed(setting)}; default {_as_text(setting.default)}]"
                metavar = setting.name.upper()
                group.add_argument(f"--{key}", metavar=metavar, help=text.replace("%", "%%"))


def _allowed(setting: Setting) -> str:
    """The allowed values of a setting, in words."""
    low, high = setting.metadata.get("low"), setting.metadata.get("high")
    if choices := setting.metadata.get("choices"):
        return " or ".join(map(str, choices))
    words = allowed(setting.kind).partition(", such as")[0]
    if low is None:
        return words if high is None else f"{words}, at most {high}"
    return f"{words}, at least {low}" if high is None else f"{words}, {low} to {high}"


def _as_text(default: Any) -> str:
    """A default value in the form of a flag's value."""
    if isinstance(default, tuple):
        return f"[{', '.join(map(str, default))}]"
    if isinstance(default, dict):
        return f"{{{', '.join(f'{name}: {value}' for name, value in default.items())}}}"
    words = {None: "null", True: "true", False: "false"}
    return words[default] if default is None or isinstance(default, bool) else str(default)
