"""YAML whose values are plainly what they look like.

A plain scalar is a decimal number, true or false, null, or text. Where YAML 1.1 and 1.2 disagree or
surprise (``012``, ``1:30``, ``yes``, ``.inf``, ``1e400``), a scalar is text, and the setting that
wants a number refuses it. A key may stand only once. Tags and aliases are errors.
"""

import re
from math import isfinite
from typing import Any

import yaml
from yaml.composer import ComposerError

INTEGER = re.compile(r"[-+]?(0|[1-9][0-9]*)")
NUMBER = re.compile(r"[-+]?((0|[1-9][0-9]*)(\.[0-9]*)?|\.[0-9]+)([eE][-+]?[0-9]+)?")
WORDS = {"": None, "~": None, "null": None, "Null": None, "NULL": None} | {
    spelling: value
    for word, value in (("true", True), ("false", False))
    for spelling in (word, word.capitalize(), word.upper())
}
TAGS = {
    yaml.ScalarNode: "tag:yaml.org,2002:str",
    yaml.SequenceNode: "tag:yaml.org,2002:seq",
    yaml.MappingNode: "tag:yaml.org,2002:map",
}


class NotYaml(ValueError):
    """Text that is no YAML, or that has what settings do not need."""


def parse(text: str) -> Any:
    """The value of a YAML text.

    Raises:
        NotYaml: in one line, what is wrong and where.
    """
    try:
        node = yaml.compose(text, Loader=_Loader)
        return None if node is None else _value(node)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        where = f" (line {mark.line + 1})" if mark else ""
        raise NotYaml(f"{error.problem or error.context}{where}") from None
    except yaml.reader.ReaderError as error:
        raise NotYaml(f"a character is not allowed (position {error.position})") from None
    except RecursionError:
        raise NotYaml("it is nested too deeply") from None


class _Loader(yaml.BaseLoader):
    """Composes nodes without guessing types."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.AliasEvent):
            event = self.peek_event()
            raise ComposerError(None, None, "aliases are not allowed", event.start_mark)
        return super().compose_node(parent, index)


def _value(node: Any) -> Any:
    line = node.start_mark.line + 1
    if node.tag != TAGS[type(node)]:
        raise NotYaml(f"tags such as {node.tag!r:.40} are not allowed (line {line})")
    if isinstance(node, yaml.SequenceNode):
        return [_value(item) for item in node.value]
    if isinstance(node, yaml.ScalarNode):
        return node.value if node.style else _plain(node.value)
    values: dict[str, Any] = {}
    for key, value in node.value:
        line = key.start_mark.line + 1
        if not isinstance(key, yaml.ScalarNode):
            raise NotYaml(f"a key is no name (line {line})")
        if key.value in values:
            raise NotYaml(f"'{key.value:.60}' stands there twice (line {line})")
        values[key.value] = _value(value)
    return values


def _plain(text: str) -> Any:
    """The value of a scalar without quotes."""
    if text in WORDS:
        return WORDS[text]
    try:
        if INTEGER.fullmatch(text):
            return int(text)
        if NUMBER.fullmatch(text) and isfinite(number := float(text)):
            return number
    except ValueError:  # thousands of digits
        pass
    return text
