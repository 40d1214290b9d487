"""The line of a curve: thick and solid at level low, thin and dashed at every other level.

Figures and recordings use the same lines. Rerun has no dashed lines, so a recording shows a dashed
line with less opacity.
"""

from dataclasses import dataclass
from zlib import crc32

from study.config.names import ENSEMBLE, FROM_DATA, ORACLE

DASHES = (3.0, 1.5)
"""Lengths of a dash and of a gap, in line widths. The paper's Fig. 3 also dashes level high."""
OTHER_DASHES = ((1.0, 1.2), (3.0, 1.2, 1.0, 1.2), (6.0, 1.5))
"""The patterns of levels beyond the paper's. The name of a level determines its pattern."""
_MODEL, _REFERENCE, _THIN = 1.5, 0.7, 0.6


@dataclass(frozen=True)
class Line:
    """The style of a curve.

    Attributes:
        width: in points of a figure.
        dashes: lengths of dashes and gaps, in line widths; empty for a solid line.
    """

    width: float
    dashes: tuple[float, ...] = ()


def line_of(model: str, level: str) -> Line:
    """The line of a model at a level. The lines of references are thin.

    The oracle does not depend on the level, so its line is always solid.
    """
    width = _REFERENCE if model in (ENSEMBLE, ORACLE, *FROM_DATA) else _MODEL
    if level == "low" or model == ORACLE:
        return Line(width)
    dashes = OTHER_DASHES[crc32(level.encode()) % len(OTHER_DASHES)]
    return Line(_THIN * width, DASHES if level == "high" else dashes)
