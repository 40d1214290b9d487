"""Small PNG files. The same picture gives the same bytes."""

import io
from collections.abc import Mapping
from pathlib import Path

from matplotlib.figure import Figure
from PIL import Image
from PIL.PngImagePlugin import PngInfo

WIDTH = 7.16
"""Width of both columns of a two-column paper, in inches."""

_COLOURS = 256


def save(figure: Figure, path: Path, dpi: int, shaded: bool = False) -> Path:
    """Write a figure as a PNG; `shaded` as in `save_image`."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=dpi)
    with Image.open(buffer) as image:
        return save_image(image, path, shaded)


def save_image(
    image: Image.Image, path: Path, shaded: bool = False, texts: Mapping[str, str] | None = None
) -> Path:
    """Write a PNG of at most 256 colours, about a third of the size of one with all colours.

    Args:
        image: the picture.
        path: the PNG; its folder is created if it is missing.
        shaded: whether the 256 colours follow the most frequent ones, as a shaded surface needs.
            Otherwise rare colours are preserved too.
        texts: text chunks of the PNG, by keyword.
    """
    method = Image.Quantize.MEDIANCUT if shaded else Image.Quantize.MAXCOVERAGE
    reduced = image.convert("RGB").quantize(_COLOURS, method, dither=Image.Dither.NONE)
    chunks = PngInfo()
    for keyword, text in (texts or {}).items():
        chunks.add_text(keyword, text)
    path.parent.mkdir(parents=True, exist_ok=True)
    reduced.save(path, format="png", optimize=True, pnginfo=chunks)
    return path


def read_texts(path: Path) -> dict[str, str]:
    """The text chunks of a PNG, by keyword."""
    with Image.open(path) as image:
        return {str(keyword): str(text) for keyword, text in image.info.items()}
