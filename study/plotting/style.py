"""How every figure looks: the same colour for the same model, the same line for the same level."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.artist import Artist
from matplotlib.colors import to_hex
from matplotlib.figure import Figure

from study.config.names import ENSEMBLE, ORACLE
from study.plotting.palette import MODELS

COLUMN_WIDTH = 3.5
"""Inches: one column of a two-column paper."""

COLOURS = {
    model: to_hex((red / 255, green / 255, blue / 255))
    for model, (red, green, blue, _) in MODELS.items()
}
"""Okabe and Ito's palette, which people with any colour vision tell apart; then Paul Tol's."""

LONGEST = 18
"""Characters of a name of which three stand side by side in a figure's legend."""

CYCLE = ("#44AA99", "#F0E442", "#000000")
"""For models of your own."""

DASHES = (0, (3, 1.5))
"""The line of high epistemic uncertainty; low is solid, as in the paper's Fig. 3."""

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
    "legend.frameon": False,
    "savefig.dpi": 300,
    # Text stays text in the PDF: it can be searched, and edited.
    "pdf.fonttype": 42,
}


def colours(models: Iterable[str]) -> dict[str, str]:
    """A colour for each model; the paper's models and references always have the same one."""
    others = [model for model in models if model not in COLOURS]
    return COLOURS | {model: CYCLE[i % len(CYCLE)] for i, model in enumerate(others)}


def line(model: str, level: str) -> dict[str, Any]:
    """How the curve of a model at a level is drawn; the references are thin."""
    width = 0.7 if model in (ENSEMBLE, ORACLE) else 1.5
    if level == "low" or model == ORACLE:
        return {"linestyle": "-", "linewidth": width}
    if level == "high":
        # Narrower, with white gaps: where it lies on the solid line, both can be seen.
        return {"linestyle": DASHES, "linewidth": 0.6 * width, "gapcolor": "white"}
    return {"linestyle": ":", "linewidth": width}


def columns(handles: Sequence[Artist]) -> int:
    """Columns of a legend as wide as a figure: three, or two where a name is long."""
    return 3 if max(len(str(handle.get_label())) for handle in handles) <= LONGEST else 2


def figure(height: float) -> Figure:
    """An empty figure one column wide and `height` inches high. Call within `context`."""
    return Figure(figsize=(COLUMN_WIDTH, height), layout="constrained")


def context() -> mpl.RcParams:
    """Within `with mpl.rc_context(context()):` figures look as they should."""
    return mpl.RcParams(SETTINGS)


def save(drawing: Figure, stem: Path) -> list[Path]:
    """Write `stem`.png and `stem`.pdf; the same drawing gives the same bytes."""
    stem.parent.mkdir(parents=True, exist_ok=True)
    png, pdf = stem.with_suffix(".png"), stem.with_suffix(".pdf")
    drawing.savefig(png, metadata={"Software": None})
    # Laid out by now: to do it again for the PDF takes half of the time.
    drawing.set_layout_engine("none")
    drawing.savefig(pdf, metadata={"CreationDate": None, "Creator": None, "Producer": None})
    return [png, pdf]
