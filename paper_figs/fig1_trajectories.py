"""Fig. 1 of the paper: forecast trajectories, with aleatoric and epistemic uncertainty.

    python -m paper_figs.fig1_trajectories results/paper

One figure for each environment, with one test scenario for each level: the scenario with the most
uncertain outcome. The forecast is that of the residual VAE, or of another model with an ensemble.

Left: the x-y plane. Observed rollouts are grey. Thick lines are the forecasts of the ensemble
members, whose variance is epistemic. Thin lines are forecast samples, in the colour of their
member; their variance about the member is aleatoric. Right: standard deviation of the forecast
position over time, with its epistemic and aleatoric parts, and that of the observed rollouts.
"""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Patch

from paper_figs.command import command
from paper_figs.scores import in_order
from study.common.errors import BadInput
from study.config.names import ENVIRONMENTS, LEVELS, RESIDUAL, label
from study.data.storage import Arrays, load_arrays
from study.plotting import style

MEMBERS = ("#0072B2", "#009E73", "#CC79A7", "#56B4E9", "#F0E442")
EPISTEMIC, ALEATORIC, OBSERVED, TARGET = "#D55E00", "#F2C14E", "#777777", "#000000"


@dataclass(frozen=True)
class Illustration:
    """The illustration of one cell, which the stage `evaluate` writes."""

    environment: str
    level: str
    model: str
    arrays: Arrays
    facts: dict[str, Any]


def plot(results: Path) -> list[Path]:
    """Write figures/overview_<environment>.png and .pdf into `results`, from its illustrations.

    Environments without illustrations have no figure.

    Raises:
        BadInput: there is no such folder.
        StudyError: an illustration is damaged.
    """
    if not results.is_dir():
        raise BadInput(f"there is no folder {results}: run `python -m study.run all` first")
    illustrations = _read(results / "illustrations")
    written = []
    for environment in in_order({entry.environment for entry in illustrations}, ENVIRONMENTS):
        part = [entry for entry in illustrations if entry.environment == environment]
        written += _plot(part, environment, results / "figures" / f"overview_{environment}")
    return written


def _read(folder: Path) -> list[Illustration]:
    """One illustration for each environment and level, of the residual VAE's first seed if any."""
    illustrations: dict[tuple[str, str], Illustration] = {}
    for path in sorted(folder.glob("*/*/*/seed-*.safetensors")):
        environment, level, model = path.relative_to(folder).parts[:3]
        key = (environment, level)
        present = illustrations.get(key)
        if present is None or (model == RESIDUAL and present.model != RESIDUAL):
            illustrations[key] = Illustration(environment, level, model, *load_arrays(path))
    ordered = in_order({level for _, level in illustrations}, LEVELS)
    return sorted(
        illustrations.values(), key=lambda entry: (entry.environment, ordered.index(entry.level))
    )


def _plot(illustrations: list[Illustration], environment: str, stem: Path) -> list[Path]:
    with mpl.rc_context(style.context()):
        figure = style.figure(height=1.75 * len(illustrations) + 0.45)
        rows = figure.subplots(len(illustrations), 2, squeeze=False, width_ratios=[1.0, 1.15])
        for (left, right), illustration in zip(rows, illustrations, strict=True):
            _paths(left, illustration)
            _standard_deviations(right, illustration)
            left.set_title(
                f"{label(environment)}, {label(illustration.level)}: {label(illustration.model)}",
                loc="left",
            )
        rows[-1, 0].set_xlabel(f"x ({_unit(illustrations[-1])})")
        rows[-1, 1].set_xlabel("time (s)")
        figure.legend(
            handles=_legend(),
            loc="outside lower center",
            ncols=3,
            handlelength=1.3,
            columnspacing=1.0,
        )
        return style.save(figure, stem)


def _paths(axes: Axes, illustration: Illustration) -> None:
    arrays = illustration.arrays
    colours = [MEMBERS[m % len(MEMBERS)] for m in range(len(arrays["members"]))]
    target = arrays["target"].astype(float)
    lines = [
        (arrays["observed"], [OBSERVED], 0.5, 0.35),
        (arrays["forecast"], [colours[m] for m in arrays["member"]], 0.5, 0.45),
        (arrays["members"], colours, 1.6, 1.0),
    ]
    for paths, shades, width, alpha in lines:
        in_plane = paths[..., :2].astype(float)
        collection = LineCollection(list(in_plane), colors=shades, linewidths=width, alpha=alpha)
        axes.add_collection(collection)
        axes.update_datalim(in_plane[np.isfinite(in_plane).all(-1)])
    radius = illustration.facts["radius"]
    if radius:  # a recorded system has no target
        centre = (target[0], target[1])
        axes.add_patch(Circle(centre, radius, fill=False, edgecolor=TARGET, zorder=5))
    axes.plot(*arrays["observed"][0, 0, :2], "o", color=TARGET, markersize=2.5, zorder=5)
    axes.autoscale_view()
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_ylabel(f"y ({_unit(illustration)})")


def _standard_deviations(axes: Axes, illustration: Illustration) -> None:
    arrays = illustration.arrays
    time = np.arange(1, len(arrays["aleatoric"]) + 1) * illustration.facts["control_step"]
    # Variances add, standard deviations do not. The border is the epistemic standard deviation.
    epistemic = np.sqrt(arrays["epistemic"])
    total = np.sqrt(arrays["epistemic"] + arrays["aleatoric"])
    axes.fill_between(time, 0, epistemic, color=EPISTEMIC, linewidth=0)
    axes.fill_between(time, epistemic, total, color=ALEATORIC, linewidth=0)
    if len(arrays["observed"]) > 1:
        std = np.sqrt(arrays["observed_variance"])
        axes.plot(time, std, color="black", linestyle=style.DASHES)
    axes.set_xlim(0, time[-1])
    axes.set_ylim(bottom=0)
    axes.set_axisbelow(True)
    axes.set_ylabel(f"std. dev. of position ({_unit(illustration)})")


def _unit(illustration: Illustration) -> str:
    """The unit of the position."""
    return str(illustration.facts.get("position_unit", "m"))


def _legend() -> list[Line2D | Patch]:
    return [
        Line2D([], [], color=OBSERVED, linewidth=0.8, label="observed rollouts"),
        Line2D([], [], color=MEMBERS[0], linewidth=1.6, label="ensemble members"),
        Line2D([], [], color=MEMBERS[0], linewidth=0.6, label="forecast samples"),
        Patch(color=EPISTEMIC, linewidth=0, label="epistemic part"),
        Patch(color=ALEATORIC, linewidth=0, label="aleatoric part"),
        Line2D([], [], color="black", linestyle=style.DASHES, label="observed std. dev."),
    ]


if __name__ == "__main__":
    sys.exit(command(plot, "Aleatoric and epistemic uncertainty of forecasts: the paper's Fig. 1."))
