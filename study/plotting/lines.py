"""The line of a curve: thick and solid at level low, thin and dashed at level high.

Figures and recordings use the same lines. Rerun has no dashed lines, so a recording shows a dashed
line with less opacity.
"""

from dataclasses import dataclass

from study.config.names import ENSEMBLE, ORACLE

DASHES = (3.0, 1.5)
"""Lengths of a dash and of a gap, in line widths. The paper's Fig. 3 also dashes level high."""
_MODEL, _REFERENCE, _HIGH = 1.5, 0.7, 0.6


@dataclass(frozen=True)
class Line:
    """The style of a curve.

    Attributes:
        width: in points of a figure.
        dashed: whether the line is dashed.
    """

    width: float
    dashed: bool


def line_of(model: str, level: str) -> Line:
    """The line of a model at a level. The lines of the oracle and the ensemble alone are thin.

    The oracle does not depend on the level, so its line is solid at both levels.
    """
    width = _REFERENCE if model in (ENSEMBLE, ORACLE) else _MODEL
    if level == "high" and model != ORACLE:
        return Line(_HIGH * width, dashed=True)
    return Line(width, dashed=False)
