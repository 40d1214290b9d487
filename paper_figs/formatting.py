"""Numbers and names in tables, for Markdown and LaTeX."""

from collections.abc import Iterable

import numpy as np

from study.config.names import BEYOND, label

NOTHING = "—"

_SPECIAL = str.maketrans(
    {
        **{character: f"\\{character}" for character in "%&#$_{}"},
        "\\": "\\textbackslash{}",
        "~": "\\textasciitilde{}",
        "^": "\\textasciicircum{}",
        "<": "$<$",
        ">": "$>$",
        "|": "$|$",
    }
)
_LATEX = (
    (" \\%", "\\,\\%"),
    (NOTHING, "---"),
    ("−", "$-$"),
    ("∞", "$\\infty$"),
    ("†", "\\textdagger{}"),
    ("²", "$^2$"),
    ("× ½", "$\\times\\frac{1}{2}$"),
    ("×", "$\\times$"),
)


def number(value: float | None, digits: int = 3) -> str:
    """A number with `digits` decimals and a minus sign; a dash for None and NaN."""
    if value is None or np.isnan(value):
        return NOTHING
    if np.isinf(value):
        return "∞" if value > 0 else "−∞"
    if abs(value) >= 1000:
        return f"{value:.1e}".replace("-", "−")
    # Adding 0 turns a rounded -0.000 into 0.000.
    return f"{round(value, digits) + 0.0:.{digits}f}".replace("-", "−")


def signed(estimate: float, low: float, high: float, digits: int = 4) -> str:
    """An estimate with its interval."""
    return f"{number(estimate, digits)} [{number(low, digits)}, {number(high, digits)}]"


def beyond(models: Iterable[str]) -> list[str]:
    """A note on models beyond the paper, if there are any."""
    return ["† Beyond the paper."] if set(models) & set(BEYOND) else []


def title(name: str) -> str:
    """The label of a name, with a capital letter."""
    text = label(name)
    return text[:1].upper() + text[1:]


def latex(text: str) -> str:
    """Text as LaTeX: special characters, and the symbols of tables, become commands."""
    text = text.translate(_SPECIAL)
    for plain, escaped in _LATEX:
        text = text.replace(plain, escaped)
    return text
