"""The line of a curve: thick and solid at level low, thin and dashed at level high.

Figures and recordings both follow it. Rerun draws no dashes, so a recording draws a dashed line
faint.
"""

from dataclasses import dataclass

from study.config.names import ENSEMBLE, ORACLE

DASHES = (3.0, 1.5)
"""Lengths of a dash and of a gap, in line widths; the paper's Fig. 3 dashes level high too."""
_MODEL, _REFERENCE, _HIGH = 1.5, 0.7, 0.6


@dataclass(frozen=True)
class Line:
    """How a curve is drawn.

    Attributes:
        width: in points of a figure.
        dashed: whether the line is dashed.
    """

    width: float
    dashed: bool


def line_of(model: str, level: str) -> Line:
    """The line of a model at a level; the references, oracle and ensemble, have a thin one.

    The oracle does not depend on the level: its line is solid at both.
    """
    width = _REFERENCE if model in (ENSEMBLE, ORACLE) else _MODEL
    if level == "high" and model != ORACLE:
        return Line(_HIGH * width, dashed=True)
    return Line(width, dashed=False)
