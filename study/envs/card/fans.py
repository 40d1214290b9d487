"""Fans: all rollouts of a scenario, in the plane and over time, coloured by their outcome."""

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
from study.data.variables import Variable
from study.envs.simulator import Simulator
from study.plotting import style
from study.plotting.png import WIDTH, save

PROBABILITIES = (0.1, 0.5, 0.9)
"""Probabilities of success; the figure shows a scenario for each."""

SUCCESS, FAILURE = "#0072B2", "#D55E00"
"""Blue and vermilion of Okabe and Ito's palette for all kinds of colour vision."""

_ROW_HEIGHT = 1.75  # inches
_TARGET = "#009E73"


def typical(success: Booleans, probabilities: Sequence[float] = PROBABILITIES) -> list[int]:
    """For each probability, the scenario whose own probability of success is nearest.

    A scenario is chosen once at most. Of several that are equally near, the first is chosen.

    Args:
        success: [S, K], of K rollouts of each of S scenarios.
        probabilities: the probabilities, in any order.
    """
    probability = success.mean(axis=1)
    chosen: list[int] = []
    for value in probabilities[: len(success)]:
        distance = np.abs(probability - value)
        distance[chosen] = np.inf
        chosen.append(int(distance.argmin()))
    return chosen


def most_uncertain(simulator: Simulator, observed: Floats, count: int = 3) -> list[str]:
    """Names of the `count` state variables with the largest share of variance from noise.

    The share is the mean variance within the K rollouts of a scenario, over the total variance.
    Horizontal positions are left out, since the plan view shows them.

    Args:
        simulator: the system.
        observed: [S, K, T, D] states.
        count: number of variables.
    """
    states = observed.astype(np.float64)
    level = simulator.position(observed)[..., :2]
    with np.errstate(invalid="ignore", divide="ignore"):
        share = np.nan_to_num(states.var(axis=1).mean(axis=(0, 1)) / states.var(axis=(0, 1, 2)))
    order = [int(i) for i in np.argsort(-share, kind="stable")]
    shown = [i for i in order if not (states[..., i, None] == level).all(axis=(0, 1, 2)).any()]
    return [simulator.state[i].name for i in sorted((shown or order)[:count])]


def plot_fans(
    simulator: Simulator,
    scenarios: ScenarioSet,
    path: Path,
    chosen: Sequence[int] | None = None,
    variables: Sequence[str] | None = None,
) -> Path:
    """Plot the observed rollouts of some scenarios, one scenario in each row.

    Args:
        simulator: the system.
        scenarios: S scenarios with K rollouts each.
        path: the PNG file.
        chosen: rows of `scenarios`; None for those of `typical`.
        variables: names of state variables to plot over time; None for those of `most_uncertain`.

    Raises:
        BadInput: the environment has no state variable of this name.
    """
    success = simulator.outcome(scenarios.observed, scenarios.goal[:, None])
    chosen = typical(success) if chosen is None else chosen
    if variables is None:
        variables = most_uncertain(simulator, scenarios.observed)
    columns = [_column(simulator, name) for name in variables]
    with mpl.rc_context(style.context()):
        figure = Figure(figsize=(WIDTH, _ROW_HEIGHT * len(chosen) + 0.3), layout="constrained")
        ratios = [1.0] + [1.25] * len(columns)
        axes = figure.subplots(len(chosen), len(ratios), squeeze=False, width_ratios=ratios)
        for row, index in zip(axes, chosen, strict=True):
            states, succeeded = _with_start(scenarios, index), success[index]
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


def _with_start(scenarios: ScenarioSet, index: int) -> Floats:
    """The states of a scenario's rollouts with s_0, [K, T+1, D]."""
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
    _plot_lines(axis, paths, success)
    axis.plot(*paths[0, 0], "o", color="black", markersize=2.5, zorder=4)
    axis.add_patch(
        Circle(tuple(target[:2]), simulator.radius, fill=False, edgecolor=_TARGET, zorder=4)
    )
    axis.autoscale_view()
    axis.set_aspect("equal", adjustable="datalim")
    axis.set_ylabel("y (m)")


def _over_time(axis: Axes, simulator: Simulator, values: Floats, success: Booleans) -> None:
    time = np.broadcast_to(np.arange(values.shape[1]) * simulator.control_step, values.shape)
    _plot_lines(axis, np.stack([time, values], axis=-1), success)
    axis.autoscale_view()
    axis.margins(x=0.0)


def _plot_lines(axis: Axes, lines: Doubles, success: Booleans) -> None:
    """Plot lines [K, T+1, 2] in the order of the rollouts, so that neither colour lies on top."""
    alpha = float(np.clip(20 / len(lines), 0.08, 0.6))
    colours = [SUCCESS if succeeds else FAILURE for succeeds in success]
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
