"""How pictures are written: small, and the same figure always as the same bytes."""

import io
from pathlib import Path

from matplotlib.figure import Figure
from PIL import Image

WIDTH = 7.16
"""Inches: both columns of a two-column paper."""

_COLOURS = 256


def save(figure: Figure, path: Path, dpi: int, shaded: bool = False) -> Path:
    """Write a PNG of at most 256 colours, a third the size of one with all of them.

    The colours of a `shaded` picture follow what there is most of; else rare ones are kept too.
    """
    drawn = io.BytesIO()
    figure.savefig(drawn, format="png", dpi=dpi)
    path.parent.mkdir(parents=True, exist_ok=True)
    with Image.open(drawn) as picture:
        method = Image.Quantize.MEDIANCUT if shaded else Image.Quantize.MAXCOVERAGE
        few = picture.convert("RGB").quantize(_COLOURS, method, dither=Image.Dither.NONE)
    few.save(path, format="png", optimize=True)
    return path
