"""The list of all settings at the end of ``all --help``."""

from argparse import ArgumentParser
from typing import Any

from study.config.tree import TOP, Setting, help_texts, known_settings, section_classes
from study.config.values import allowed


def add_settings(parser: ArgumentParser) -> None:
    """Add every setting to the help of a parser, in a group for each section."""
    texts = help_texts()
    known = known_settings()
    for name, settings in section_classes().items():
        summary = (settings.__doc__ or "").strip().partition("\n")[0].rstrip(".")
        group = parser.add_argument_group(f"{name}: {summary}" if name != TOP else summary)
        for key, each in known.items():
            if each.section == name:
                text = f"{texts[key]} [{_allowed(each)}; default {_shown(each.default)}]"
                metavar = each.name.upper()
                group.add_argument(f"--{key}", metavar=metavar, help=text.replace("%", "%%"))


def _allowed(each: Setting) -> str:
    """What a setting must be, with its bounds."""
    low, high = each.metadata.get("low"), each.metadata.get("high")
    if choices := each.metadata.get("choices"):
        return " or ".join(map(str, choices))
    words = allowed(each.kind).partition(", such as")[0]
    if low is None:
        return words if high is None else f"{words}, at most {high}"
    return f"{words}, at least {low}" if high is None else f"{words}, {low} to {high}"


def _shown(default: Any) -> str:
    """A default as a flag would give it."""
    if isinstance(default, tuple):
        return f"[{', '.join(map(str, default))}]"
    if isinstance(default, dict):
        return f"{{{', '.join(f'{name}: {value}' for name, value in default.items())}}}"
    words = {None: "null", True: "true", False: "false"}
    return words[default] if default is None or isinstance(default, bool) else str(default)
