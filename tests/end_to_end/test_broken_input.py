"""300 broken configurations, flags and plugins: exit code 2, one or two lines, nothing written.

Each is generated from its number, so a failure can be repeated.
"""

import random
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from study.commands.settings import CONFIGS
from study.config.tree import known_settings
from study.config.values import takes_text
from tests.helpers.running import Done, study

SMOKE = (CONFIGS / "smoke.yaml").read_text(encoding="utf-8")
NEVER_VALID = (
    "",
    "~",
    ".inf",
    "-.inf",
    ".nan",
    "1e400",
    "012",
    "1:30",
    "0x10",
    "1_000",
    "yes",
    "2001-01-01",
    "[",
    "]",
    "{",
    "[[1]]",
    "[1, [2]]",
    "{a: 1}",
    "[null]",
    "[]",
    "{}",
    "!!int 3",
    "&a 1",
    "*a",
    "9" * 5000,
    "-9" * 40,
    "'1'",
    "tru",
    "one two",
    "«",
    "%",
    "- 1",
    "? 1",
    "[1, 2",
    '"',
    "\t1",
)
"""Values that no setting allows which is not text."""
HEAD = """
from dataclasses import dataclass
from study.config.sections import section, setting
from study.config.settings import Train
from study.envs import Simulator, register
from study.models import Model, models
"""
MODEL = """
@dataclass(frozen=True)
class Settings:
    train: Train
    {own}

@models.register({name!r})
class Mine(Model):
    settings_class = {settings}
    {body}
"""
COMPLETE = (
    "def losses(self, batch, step): ...\n    def sample(self, s0, actions, noise, member): ..."
)


def _typo(choose: random.Random, name: str) -> str:
    """A name with one letter removed, added or replaced."""
    position = choose.randrange(len(name))
    middle = choose.choice(["", name[position] + "_", "x", "é", " "])
    return name[:position] + middle + name[position + 1 :]


def _wrong_value(choose: random.Random, key: str) -> str:
    """A value that the setting does not allow."""
    setting = known_settings()[key]
    wrong = [*NEVER_VALID, "text"]
    if (low := setting.metadata.get("low")) is not None and key != "grid.levels":
        wrong += [str(low - 1), "-1", f"[{low - 1}]"]
    if (high := setting.metadata.get("high")) is not None:
        wrong += [str(high + 1), "1" + "0" * 30]
    return choose.choice(wrong)


def _not_text(choose: random.Random) -> str:
    """The name of a setting that is no text and cannot be null or empty."""
    allowed = ("plugins", "ablations", "collect.horizon")
    known = known_settings().items()
    return choose.choice(
        [key for key, each in known if not takes_text(each.kind) and key not in allowed]
    )


def _nested(key: str, value: str) -> str:
    """A YAML file with one setting."""
    *sections, name = key.split(".")
    lines = [f"{'  ' * depth}{section}:" for depth, section in enumerate(sections)]
    return "\n".join([*lines, f"{'  ' * len(sections)}{name}: {value}"]) + "\n"


def broken_file(choose: random.Random) -> bytes:
    """A configuration that is broken in one way."""
    key = _not_text(choose)
    section = key.partition(".")[0]
    ways: list[Callable[[], str | bytes]] = [
        lambda: _nested(key, _wrong_value(choose, key)),
        lambda: _nested(key, _wrong_value(choose, key)),
        lambda: _nested(_typo(choose, key), "3"),
        lambda: SMOKE + _nested(key, "3") * 2,
        lambda: f"{section}: {choose.choice(NEVER_VALID[:14])}\n",
        lambda: _nested(f"{key}.deeper", "1"),
        lambda: SMOKE.replace(":", choose.choice(["", " :\t", ";", ": :"]), 3),
        lambda: "[" * choose.randrange(1, 5000),
        lambda: "name: ü\n".encode("latin-1") + SMOKE.encode(),
        lambda: SMOKE.encode()[: choose.randrange(300)] + bytes([choose.choice([0, 1, 27, 255])]),
        lambda: choose.choice(
            ["", "#", "3", "- name", "null", "---\na: 1\n---\nb: 2\n", "? [a]\n: b"]
        ),
        lambda: _nested("name", choose.choice(["a/b", ".", "..", "''", "x\\0", "'a\nb'", "12"])),
        lambda: f"<<: {{tune: {{trials: 3}}}}\n{SMOKE}",
        lambda: _nested("model.unknown.size", "3"),
        lambda: _nested(
            "grid.levels", choose.choice(["[tiny]", "{a/b: 1}", "{low: 2}", "{x: 1e-9}"])
        ),
    ]
    text = choose.choice(ways)()
    return text if isinstance(text, bytes) else text.encode()


def broken_flags(choose: random.Random) -> list[str]:
    """A command line that is broken in one way."""
    key = _not_text(choose)
    ways: list[Callable[[], list[str]]] = [
        lambda: [f"--{key}={_wrong_value(choose, key)}"],
        lambda: [f"--{key}", _wrong_value(choose, key) or "~"],
        lambda: [f"--{_typo(choose, key)}=3"],
        lambda: [f"--{key}"],
        lambda: [f"--{key}", "--out", "elsewhere"],
        lambda: [choose.choice(["surplus", "-x", "--", "--=", "---", "-", "\udcff", "a\nb"])],
        lambda: [
            "--config",
            choose.choice(["nowhere.yaml", ".", "/dev/null", "/proc/self/mem", "a\nb"]),
        ],
        lambda: ["--config", "one.yaml", "--config=two.yaml"],
        lambda: ["--only", choose.choice(["nothing/*", "[", "pusher/lo", "\n"])],
        lambda: ["--name", choose.choice(["a/b", "..", "a b", "x" * 300, "a\nb", "", "é"])],
        lambda: [f"--grid.environments=[{_typo(choose, 'pusher')}]"],
        lambda: [f"--grid.models=[{_typo(choose, 'full_vae')}]"],
        lambda: [
            f"--plugins=[{choose.choice(['nowhere', '../x', 'x.py', '.', 'a b', '3', 'a..b'])}]"
        ],
        lambda: ["--out", choose.choice(["/proc/nowhere", "/dev/null", "/dev/null/x", "x" * 300])],
        lambda: [
            f"--grid.levels={choose.choice(['low', '[low, low]', '{}', '{low: x}', '{.: 1}'])}"
        ],
    ]
    return choose.choice(ways)()


def broken_plugin(choose: random.Random) -> str:
    """The source of a plugin that is broken in one way."""
    name = f"mine_{choose.randrange(10**9)}"
    whole = {"name": name, "own": "", "settings": "Settings", "body": COMPLETE}
    bad_names = ("", "a/b", "oracle", "all", "x" * 300, "a b", 3, "residual_vae", "é", "-", "a\nb")

    def model(**changes: object) -> str:
        return HEAD + MODEL.format(**{**whole, **changes})

    own = (
        "size: int",
        "size: int = setting(0, low=1)",
        "size: dict = setting({})",
        "size: Train",
        "size: int = setting('x')",
        "size: object = None",
        "size: int = setting(3, choices=(1,))",
        "size: unknown = 1",
        "size: list = []",
        "size: int = setting(1.5)",
    )
    ways: list[Callable[[], str]] = [
        lambda: model() + choose.choice(["def f(:", "  x = 1", "'", "\x00", "return", "x ="]),
        lambda: model() + f"raise {choose.choice(['ValueError', 'KeyError'])}('a\\nb' * 500)",
        lambda: model() + choose.choice(["1 / 0", "exit(0)", "raise SystemExit", "import nowhere"]),
        lambda: model(own=choose.choice(own)),
        lambda: model(name=choose.choice(bad_names)),
        lambda: model(body=choose.choice(["pass", "def losses(self, batch, step): ...", "x ="])),
        lambda: model(settings=choose.choice(["None", "dict", "Train", "unknown", "Model"])),
        lambda: HEAD + f"models.register({name!r})({choose.choice(['3', 'int', 'None', 'print'])})",
        lambda: HEAD + f"register({name!r})({choose.choice(['3', 'int', 'None', 'Simulator'])})",
        lambda: HEAD + f"@register({name!r})\nclass Mine(Simulator):\n    name = {name!r}\n",
        lambda: HEAD + f"@register({choose.choice(bad_names[:-4])!r})\nclass Mine(Simulator): ...",
        lambda: (
            HEAD
            + f"@section({choose.choice(bad_names[:6])!r})\n@dataclass(frozen=True)\nclass A: ..."
        ),
    ]
    return choose.choice(ways)()


def refused(folder: Path, done: Done) -> None:
    """Check that a command was refused, in a folder that has the files `input*` alone."""
    assert done.code == 2, done
    assert done.out == ""
    assert done.err.startswith("error: ")
    assert 1 <= done.err.count("\n") <= 2
    assert done.err.endswith("\n")
    assert "Traceback" not in done.err
    assert len(done.err) < 2500
    written = [path.name for path in folder.iterdir() if path.name != "__pycache__"]
    assert all(name.startswith("input") for name in written)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder to work in."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    return tmp_path


@pytest.mark.parametrize("number", range(100))
def test_a_broken_file(number: int, folder: Path) -> None:
    path = folder / "input.yaml"
    path.write_bytes(broken_file(random.Random(number)))
    refused(folder, study("plan", "--config", path.name, "--out", "out"))


@pytest.mark.parametrize("number", range(100))
def test_broken_flags(number: int, folder: Path) -> None:
    refused(folder, study("all", *broken_flags(random.Random(number))))


@pytest.mark.parametrize("number", range(100))
def test_a_broken_plugin(number: int, folder: Path) -> None:
    name = f"input_{number}"
    (folder / f"{name}.py").write_text(broken_plugin(random.Random(number)), encoding="utf-8")
    refused(folder, study("plan", f"--plugins=[{name}]", f"--grid.models=[{name}]"))


@pytest.mark.parametrize("number", range(50))
def test_a_file_with_random_changes(number: int, folder: Path) -> None:
    """It may still be valid. Then `plan` says what would run."""
    choose, text = random.Random(number), SMOKE
    for _ in range(choose.randrange(1, 6)):
        position = choose.randrange(len(text))
        letter = choose.choice([*"{}[]:,#&*!|>'\"%@`-?\n \t~0.", "\x00", "é", ""])
        text = text[:position] + letter + text[position + choose.randrange(2) :]
    path = folder / "input.yaml"
    path.write_text(text, encoding="utf-8")
    done = study("plan", "--config", path.name, "--out", "out")
    if done.code == 0:
        assert "stages to run" in done.out
        assert not done.err
        assert list(folder.iterdir()) == [path]
    else:
        refused(folder, done)
