"""The style of all figures: the same colour for a model, and the same line for a level."""

import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.artist import Artist
from matplotlib.backends.backend_pdf import PdfPages
from matplotlib.colors import to_hex
from matplotlib.figure import Figure

from study.common.files import replacing
from study.plotting import lines, png
from study.plotting.palette import Colour, model_colours

COLUMN_WIDTH = 3.5
"""Width of one column of a two-column paper, in inches."""

DPI = 300
"""Pixels of a PNG for each inch."""
METADATA: dict[str, Any] = {"CreationDate": None, "Creator": None, "Producer": None}
"""Of a PDF: the same figure gives the same bytes."""

LONGEST_LABEL = 18
"""Most characters of a label with which a legend has three columns."""

DASHES = (0, lines.DASHES)
"""The dash pattern of high epistemic uncertainty, in Matplotlib's form."""

SETTINGS = {
    "font.family": "DejaVu Sans",
    "font.size": 7.5,
    "axes.labelsize": 7.5,
    "axes.titlesize": 8,
    "legend.fontsize": 6.5,
    "xtick.labelsize": 6.5,
    "ytick.labelsize": 6.5,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#E6E6E6",
    "grid.linewidth": 0.5,
    "lines.linewidth": 1.3,
    "savefig.dpi": DPI,  # of images within a PDF and within the page
    "legend.frameon": False,
    # Text stays text in the PDF, so that a reader can search and edit it.
    "pdf.fonttype": 42,
}


def hexadecimal(colour: Colour) -> str:
    """A colour of the palette without its opacity, such as ``"#0072b2"``."""
    red, green, blue, _ = colour
    return to_hex((red / 255, green / 255, blue / 255))


def colours(models: Iterable[str]) -> dict[str, str]:
    """The hexadecimal colour of each model; see `study.plotting.palette.model_colours`."""
    return {model: hexadecimal(colour) for model, colour in model_colours(models).items()}


COLOURS = colours(())
"""The hexadecimal colours of the study's models."""


def line(model: str, level: str) -> dict[str, Any]:
    """Matplotlib's settings for the curve of a model at a level; see `study.plotting.lines`."""
    style = lines.line_of(model, level)
    if not style.dashes:
        return {"linestyle": "-", "linewidth": style.width}
    # White gaps make a dashed line visible on top of a solid one.
    return {"linestyle": (0, style.dashes), "linewidth": style.width, "gapcolor": "white"}


def columns(handles: Sequence[Artist]) -> int:
    """Columns of a legend as wide as a figure: three, or two where a label is long."""
    return 3 if max(len(str(handle.get_label())) for handle in handles) <= LONGEST_LABEL else 2


def figure(height: float) -> Figure:
    """An empty figure, one column wide and `height` inches high. Call within `context`."""
    return Figure(figsize=(COLUMN_WIDTH, height), layout="constrained")


def context() -> mpl.RcParams:
    """The settings of all figures, for ``with mpl.rc_context(context()):``.

    Those that are not in `SETTINGS` are Matplotlib's defaults, and not those of a ``matplotlibrc``.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", mpl.MatplotlibDeprecationWarning)
        defaults = {name: mpl.rcParamsDefault[name] for name in mpl.rcParamsDefault}
        del defaults["backend"]  # a figure is written without one
        return mpl.RcParams(defaults | SETTINGS)


def save(drawing: Figure, stem: Path) -> list[Path]:
    """Write a figure as `stem`.png and `stem`.pdf, or with the function given to `written_by`."""
    return _WRITER.get()(drawing, stem)


@contextmanager
def written_by(writer: "Writer") -> Iterator[None]:
    """Let `writer` write the figures that are saved in this context."""
    token = _WRITER.set(writer)
    try:
        yield
    finally:
        _WRITER.reset(token)


def write_png_and_pdf(drawing: Figure, stem: Path) -> list[Path]:
    """Write `stem`.png and `stem`.pdf; the same figure gives the same bytes."""
    picture, pdf = stem.with_suffix(".png"), stem.with_suffix(".pdf")
    _write(drawing, picture, pdf)
    return [picture, pdf]


@contextmanager
def one_pdf(path: Path) -> Iterator[None]:
    """Let figures that are saved in this context share a PDF, with a page for each.

    It has the fonts once, so it is much smaller than a PDF for each figure. Each figure has its own
    PNG. A function given to `written_by` writes as it does without this context.
    """
    if _WRITER.get() is not write_png_and_pdf:
        yield
        return
    with replacing(path) as temporary, PdfPages(temporary, metadata=METADATA) as pages:

        def write(drawing: Figure, stem: Path) -> list[Path]:
            _write(drawing, stem.with_suffix(".png"), pages)
            return [stem.with_suffix(".png")]

        with written_by(write):
            yield


def _write(drawing: Figure, picture: Path, pdf: Path | PdfPages) -> None:
    png.save(drawing, picture, DPI, shaded=True)
    # The PDF has the layout of the PNG. To compute it twice would take half of the time.
    drawing.set_layout_engine("none")
    if isinstance(pdf, PdfPages):
        pdf.savefig(drawing)
    else:
        drawing.savefig(pdf, metadata=METADATA)


Writer = Callable[[Figure, Path], list[Path]]
"""Writes a figure under a path without suffix, and returns the paths of the files."""

_WRITER: ContextVar[Writer] = ContextVar("writer", default=write_png_and_pdf)
