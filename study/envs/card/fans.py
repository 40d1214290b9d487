"""Fans: how the rollouts of one scenario come apart over the horizon, and which succeed."""

from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle

from study.common.arrays import Booleans, Doubles, Floats
from study.common.errors import BadInput, nearest
from study.data.trajectories import ScenarioSet
from study.envs.simulator import Simulator, Variable
from study.plotting import style
from study.plotting.png import WIDTH, save

WANTED = (0.1, 0.5, 0.9)
"""The true probabilities of success that scenarios are shown for."""

SUCCESS, FAILURE = "#0072B2", "#D55E00"
"""Okabe and Ito's blue and vermilion, which people with any colour vision tell apart."""

_ROW = 1.75
_TARGET = "#009E73"


def typical(success: Booleans, wanted: Sequence[float] = WANTED) -> list[int]:
    """For each wanted probability the scenario whose own is nearest, of K rollouts [S, K].

    No scenario is chosen twice; of several as near, the first.
    """
    probability = success.mean(axis=1)
    chosen: list[int] = []
    for value in wanted[: len(success)]:
        distance = np.abs(probability - value)
        distance[chosen] = np.inf
        chosen.append(int(distance.argmin()))
    return chosen


def most_uncertain(simulator: Simulator, observed: Floats, count: int = 3) -> list[str]:
    """The `count` state variables that noise moves most, of states [S, K, T, D].

    By the mean variance over the K rollouts of one scenario, as a share of the variable's whole
    variance. East and north positions are left out: the plan view shows them.
    """
    states = observed.astype(np.float64)
    level = simulator.position(observed)[..., :2]
    with np.errstate(invalid="ignore", divide="ignore"):
        share = np.nan_to_num(states.var(axis=1).mean(axis=(0, 1)) / states.var(axis=(0, 1, 2)))
    order = [int(i) for i in np.argsort(-share, kind="stable")]
    shown = [i for i in order if not (states[..., i, None] == level).all(axis=(0, 1, 2)).any()]
    return [simulator.state[i].name for i in sorted((shown or order)[:count])]


def fans(
    simulator: Simulator,
    scenarios: ScenarioSet,
    path: Path,
    chosen: Sequence[int] | None = None,
    variables: Sequence[str] | None = None,
) -> Path:
    """Write the observed rollouts of some scenarios to `path`, a PNG; a row for each scenario.

    Args:
        simulator: says where things are, and what succeeds.
        scenarios: S scenarios, K rollouts of each.
        path: the picture.
        chosen: which of the scenarios; those of `typical` if None.
        variables: names of the state variables over time; those of `most_uncertain` if None.

    Raises:
        BadInput: the environment has no variable of this name.
    """
    success = simulator.outcome(scenarios.observed, scenarios.goal[:, None])
    chosen = typical(success) if chosen is None else chosen
    if variables is None:
        variables = most_uncertain(simulator, scenarios.observed)
    columns = [_column(simulator, name) for name in variables]
    with mpl.rc_context(style.context()):
        figure = Figure(figsize=(WIDTH, _ROW * len(chosen) + 0.3), layout="constrained")
        ratios = [1.0] + [1.25] * len(columns)
        axes = figure.subplots(len(chosen), len(ratios), squeeze=False, width_ratios=ratios)
        for row, index in zip(axes, chosen, strict=True):
            states, succeeded = _whole(scenarios, index), success[index]
            _plan_view(row[0], simulator, states, scenarios.goal[index], succeeded)
            title = f"scenario {index}: {succeeded.sum()} of {len(succeeded)} succeed"
            row[0].set_title(title, loc="left", fontsize=7)
            for axis, column in zip(row[1:], columns, strict=True):
                _over_time(axis, simulator, states[..., column], succeeded)
                axis.set_ylabel(_label(simulator.state[column]))
        for axis in axes[-1, 1:]:
            axis.set_xlabel("time (s)")
        axes[-1, 0].set_xlabel("x (m)")
        figure.align_ylabels()
        figure.legend(handles=_legend(), loc="outside upper right", ncols=4)
        return save(figure, path, dpi=180)


def _column(simulator: Simulator, name: str) -> int:
    names = [variable.name for variable in simulator.state]
    if name not in names:
        raise BadInput(f"no state variable '{name}': {nearest(name, names)}")
    return names.index(name)


def _label(variable: Variable) -> str:
    return variable.name if variable.unit == "1" else f"{variable.name} ({variable.unit})"


def _whole(scenarios: ScenarioSet, index: int) -> Floats:
    """The rollouts of a scenario with their common start, [K, T+1, D]."""
    observed = scenarios.observed[index]
    start = np.broadcast_to(scenarios.s0[index], (len(observed), 1, observed.shape[-1]))
    return np.concatenate([start, observed], axis=1)


def _plan_view(
    axis: Axes, simulator: Simulator, states: Floats, goal: Floats, success: Booleans
) -> None:
    paths = simulator.position(states)[..., :2].astype(np.float64)
    target = simulator.target(goal).astype(np.float64)
    axis.add_patch(
        Circle(tuple(target[:2]), simulator.radius, facecolor=_TARGET, alpha=0.35, zorder=1)
    )
    _draw(axis, paths, success)
    axis.plot(*paths[0, 0], "o", color="black", markersize=2.5, zorder=4)
    axis.add_patch(
        Circle(tuple(target[:2]), simulator.radius, fill=False, edgecolor=_TARGET, zorder=4)
    )
    axis.autoscale_view()
    axis.set_aspect("equal", adjustable="datalim")
    axis.set_ylabel("y (m)")


def _over_time(axis: Axes, simulator: Simulator, values: Floats, success: Booleans) -> None:
    time = np.broadcast_to(np.arange(values.shape[1]) * simulator.control_step, values.shape)
    _draw(axis, np.stack([time, values], axis=-1), success)
    axis.autoscale_view()
    axis.margins(x=0.0)


def _draw(axis: Axes, lines: Doubles, success: Booleans) -> None:
    """Lines [K, T+1, 2]; neither kind is drawn over the other, for they come in their order."""
    alpha = float(np.clip(20 / len(lines), 0.08, 0.6))
    colours = [SUCCESS if each else FAILURE for each in success]
    axis.add_collection(
        LineCollection(list(lines), colors=colours, linewidths=0.6, alpha=alpha, zorder=2)
    )


def _legend() -> list[Line2D]:
    return [
        Line2D([], [], color=SUCCESS, label="succeeds"),
        Line2D([], [], color=FAILURE, label="fails"),
        Line2D([], [], color="black", marker="o", linestyle="", markersize=3, label="start"),
        Line2D([], [], color=_TARGET, marker="o", linestyle="", fillstyle="none", label="target"),
    ]
