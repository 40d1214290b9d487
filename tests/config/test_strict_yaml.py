"""A YAML value is what it looks like, or it is text."""

from typing import Any

import pytest

from study.config.strict_yaml import NotYaml, parse


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("3", 3),
        ("-3", -3),
        ("0", 0),
        ("1.5", 1.5),
        ("1e-3", 1e-3),
        (".5", 0.5),
        ("1E5", 1e5),
        ("true", True),
        ("False", False),
        ("null", None),
        ("~", None),
        ("", None),
        ("'3'", "3"),
        ('"true"', "true"),
        ("[1, a, [b]]", [1, "a", ["b"]]),
        ("{a: 1, b: {c: d}}", {"a": 1, "b": {"c": "d"}}),
        ("a: |\n  two\n  lines\n", {"a": "two\nlines\n"}),
    ],
)
def test_plain_values(text: str, expected: Any) -> None:
    value = parse(text)
    assert value == expected
    assert type(value) is type(expected)


@pytest.mark.parametrize(
    "text",
    [
        *("012", "0x10", "0o7", "1:30", "1_000", "yes", "No", "on", ".inf", "-.INF", ".nan"),
        *("1e400", "2001-01-01", "9" * 5000, "+", "1e", "é", "١"),
    ],
)
def test_what_only_looks_like_a_value_is_text(text: str) -> None:
    assert parse(text) == text


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("a: 1\nb: 2\na: 3", r"'a' stands there twice \(line 3\)"),
        ("a: {b: 1, b: 1}", "'b' stands there twice"),
        ("a: &x 1\nb: *x", r"aliases are not allowed \(line 2\)"),
        ("a: !!python/object:os.system {}", "tags such as .* are not allowed"),
        ("a: !!int '012'", "tags such as .* are not allowed"),
        ("? [a]\n: b", "a key is no name"),
        ("a: [1", r"\(line 1\)"),
        ("[" * 3000, "nested too deeply"),
        ("a: \x01", "a character is not allowed"),
        ("--- a\n--- b", "document"),
    ],
)
def test_what_is_refused(text: str, reason: str) -> None:
    with pytest.raises(NotYaml, match=reason) as refused:
        parse(text)
    assert "\n" not in str(refused.value)
