"""``data.rrd``: training trajectories of an environment."""

from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from study.common.arrays import Array, Doubles, Floats
from study.data.trajectories import Trajectories
from study.data.variables import Variable
from study.envs.simulator import Simulator
from study.plotting.palette import HIGHLIGHT, OBSERVED, TARGET, faint
from study.recording import bands, blueprints, paths, scenes, viewpoint
from study.recording.distance import Distance
from study.recording.properties import Properties, table, write_markdown, write_readme
from study.recording.streams import (
    entity_path,
    finite,
    recording,
    send_scalars,
    style_lines,
    time_column,
)

KIND = "data"
TIMELINE = "step"
# Bodies need a close-up if they are smaller than this share of the paths' extent.
_TINY = 0.02
# Opaque, since the viewer darkens transparent lines in 3D.
_OTHERS = (120, 120, 120, 255)
# Largest number of plots on a page.
_PLOTS = 8

_README = """
# Training data

The models of this environment learn from trajectories of the real system. The trajectories differ
in initial state, target and noise. The actions are planned on the system without noise, and then
executed with noise. Each of the first tabs shows one trajectory in **orange**, and the other
trajectories of this recording in **grey**.
"""
_HOW_TO_READ = """
**Orange** is this trajectory, **grey** are the other trajectories of this recording.

- *Paths*: the trajectories in 3D. The orange dot and the bodies show this trajectory at the time
  cursor. **Green** is its target, and the sphere in which the goal counts as reached. Green dots
  are the targets of the other trajectories.
{close_up}- *Distance to the target*: the goal is reached where the line falls below the green line.
- *Actions* and *State*, on the right: the actions are inputs of a model, which forecasts the state.
"""
_README_RECORDED = """
# Training data

The models of this system learn from windows of its logs. Each of the first tabs shows one window in
**orange**, and the other windows of this recording in **grey**.
"""
_HOW_TO_READ_RECORDED = """
**Orange** is this window, **grey** are the other windows of this recording.

- *Actions* and *State*, on the right: the actions are inputs of a model, which forecasts the state.
"""
_OF_CLOSE_UP = "- *Close-up*: the bodies at the time cursor. The view moves along with them.\n"


@dataclass(frozen=True)
class _Selected:
    """A trajectory with a tab.

    Attributes:
        row: number of the trajectory.
        title: of the tab.
        rule: the predicate by which the trajectory was selected, as text.
    """

    row: int
    title: str
    rule: str

    @property
    def root(self) -> str:
        """The parent of all entities of the trajectory."""
        return entity_path(self.title.lower().replace(" ", "_"))


def record_data(
    path: Path, simulator: Simulator, trajectories: Trajectories, properties: Properties
) -> None:
    """Write the recording of some trajectories. About 20 are enough to show their variation.

    `/state/NAME` and `/action/NAME` hold a column for each trajectory on the timeline `step`.
    Action a_t is at step t. `/unobserved/NAME` holds a value for each trajectory on the timeline
    `trajectory`. Values that are not finite become NaN.

    Args:
        path: the recording.
        simulator: the real system.
        trajectories: N trajectories.
        properties: of the recording.
    """
    positions = simulator.position(trajectories.states).astype(np.float32)
    targets = np.asarray(simulator.target(trajectories.goal), dtype=np.float32)
    if not simulator.has_target:
        targets = positions[:, 0]
    distance = Distance.of(simulator, trajectories)
    selected = _select(distance)
    model = simulator.scene()
    close_up = _close_up(model, positions)
    design = _design(simulator, selected, positions, targets, close_up, distance.title)
    with recording(path, KIND, properties, design, footer=False) as stream:
        readme = _README if simulator.has_target else _README_RECORDED
        write_readme(stream, readme + _tables(simulator, trajectories, distance), properties)
        scenes.log_fixed(stream, simulator, model, trajectories.states[0, 0])
        if simulator.has_position:
            paths.log_paths(stream, "/paths/all", positions, _OTHERS)
        if simulator.has_target:
            dots = rr.Points3D(targets, colors=[faint(TARGET, 150)], radii=rr.Radius.ui_points(3.0))
            stream.log("/paths/targets", dots, static=True)
        _log_signals(stream, simulator, trajectories, distance.values, selected)
        for item in selected:
            about = _about(simulator, trajectories, item, close_up is not None)
            write_markdown(stream, f"{item.root}/about", about)
            if simulator.has_target:
                target, entity = targets[item.row], f"{item.root}/paths/target"
                paths.log_target(stream, entity, target, simulator.radius)
            _log_trajectory(stream, item.root, simulator, model, trajectories.states[item.row])


def _select(distance: Distance) -> list[_Selected]:
    """The trajectories with the smallest, the median and the largest distance."""
    order = np.argsort(distance.extreme, kind="stable")
    rows = (order[0], order[len(order) // 2], order[-1])
    selected: dict[int, _Selected] = {}
    for row, (title, rule) in zip(rows, distance.rules, strict=True):
        selected.setdefault(int(row), _Selected(int(row), title, rule))
    return list(selected.values())


def _design(
    simulator: Simulator,
    selected: list[_Selected],
    positions: Floats,
    targets: Floats,
    close_up: rrb.EyeControls3D | None,
    distance_title: str,
) -> rrb.Blueprint:
    """The layout, with pages for the signals and an eye for each scene."""
    plotted = tuple(v for v in simulator.state if v.name in simulator.plotted)
    remaining = tuple(v for v in simulator.state if v.name not in simulator.plotted)
    pages = {
        "Actions and their effect" if plotted else "Actions": [
            *_signals("action", simulator.action),
            *_signals("state", plotted),
        ]
    }
    state = _signals("state", remaining)
    count = -(-len(state) // _PLOTS)
    for page in range(count):
        part = state[page * len(state) // count : (page + 1) * len(state) // count]
        pages[f"State {page + 1}" if count > 1 else "State"] = part
    # Large bodies must stay in view on all paths. Small bodies are visible in the close-up.
    eyes = {
        item.root: viewpoint.eye(
            positions if close_up is None else positions[item.row], targets[item.row]
        )
        for item in selected
        if simulator.has_position
    }
    roots = {item.title: item.root for item in selected}
    return blueprints.data(roots, pages, eyes, close_up, distance_title)


def _signals(group: str, variables: tuple[Variable, ...]) -> list[tuple[str, str]]:
    """Title and entity of each variable's plot, with the group, since groups can share names."""
    return [(f"{group} {bands.title(v)}", entity_path(group, v.name)) for v in variables]


def _close_up(model: mujoco.MjModel | None, positions: Floats) -> rrb.EyeControls3D | None:
    """An eye near the bodies, if they are too small to be visible in a view of the paths."""
    if model is None:
        return None
    moving = scenes.moving_bodies(model)
    points = positions.reshape(-1, 3)
    points = points[np.isfinite(points).all(axis=1)]
    geoms = np.isin(model.geom_bodyid, moving)
    if not len(points) or not geoms.any():
        return None
    reach = np.linalg.norm(model.geom_pos[geoms], axis=1) + model.geom_rbound[geoms]
    size = float(reach.max())
    if size > _TINY * float(np.ptp(points, axis=0).max()):
        return None
    return viewpoint.close_up(size)


def _log_signals(
    stream: rr.RecordingStream,
    simulator: Simulator,
    trajectories: Trajectories,
    distance: Doubles,
    selected: list[_Selected],
) -> None:
    """Log each signal of all trajectories, and again the signals of the selected trajectories."""
    names = [f"trajectory {row}" for row in range(len(trajectories))]
    grey = [faint(OBSERVED, 110)] * len(names)
    signals: dict[str, Array] = {"distance": distance}
    for group, variables, values in (
        ("state", simulator.state, trajectories.states),
        ("action", simulator.action, trajectories.actions),
    ):
        for column, variable in enumerate(variables):
            signals[entity_path(group, variable.name)] = finite(values[..., column])
    for entity, values in signals.items():
        steps = np.arange(values.shape[1])
        style_lines(stream, entity, names, grey, 0.8)
        send_scalars(stream, entity, TIMELINE, steps, values.T)
        for item in selected:
            item_entity = f"{item.root}/{entity.strip('/')}"
            style_lines(stream, item_entity, [f"trajectory {item.row}"], [HIGHLIGHT], 2.5)
            send_scalars(stream, item_entity, TIMELINE, steps, values[item.row])
    steps = np.arange(trajectories.horizon + 1)
    if simulator.has_target:
        style_lines(stream, "radius", ["success"], [TARGET], 2.0)
        send_scalars(stream, "radius", TIMELINE, steps, np.full(len(steps), simulator.radius))
    for column, variable in enumerate(simulator.unobserved):
        entity, rows = entity_path("unobserved", variable.name), np.arange(len(trajectories))
        unobserved = finite(trajectories.unobserved[:, column])
        send_scalars(stream, entity, "trajectory", rows, unobserved)


def _log_trajectory(
    stream: rr.RecordingStream,
    root: str,
    simulator: Simulator,
    model: mujoco.MjModel | None,
    states: Floats,
) -> None:
    """Log one trajectory [T+1, D] in the scene: its path, its dot, and the motion of the bodies."""
    if not simulator.has_position:
        return
    states = states[: scenes.finite_steps(states)]
    positions = simulator.position(states).astype(np.float32)
    times = [time_column(TIMELINE, np.arange(len(states)))]
    line = rr.LineStrips3D([positions], colors=[HIGHLIGHT], radii=rr.Radius.ui_points(2.0))
    stream.log(f"{root}/paths/selected", line, static=True)
    style = rr.Points3D.from_fields(colors=[HIGHLIGHT], radii=rr.Radius.ui_points(6.0))
    stream.log(f"{root}/paths/selected_dot", style, static=True)
    dots = rr.Points3D.columns(positions=positions)
    stream.send_columns(f"{root}/paths/selected_dot", times, dots)
    # In a viewer without a window, an eye does not track an entity. So the origin of the view moves
    # with the body. It does not rotate, so that a tilt of the body is visible.
    frame = rr.Transform3D.columns(translation=positions)
    stream.send_columns(f"{root}/{blueprints.FOLLOW}", times, frame)
    scenes.log_moving(stream, f"{root}/scene", simulator, model, states, TIMELINE)


def _about(
    simulator: Simulator, trajectories: Trajectories, item: _Selected, close_up: bool
) -> str:
    """The panel of a selected trajectory: its outcome, its goal, and how to read its views."""
    states, goal = trajectories.states[item.row], trajectories.goal[item.row]
    if not simulator.has_target:
        return _about_recorded(simulator, trajectories, item)
    success = bool(simulator.outcome(states[1:], goal))
    seconds = simulator.control_step * trajectories.horizon
    text = (
        f"# {item.title}\n\nOf the {len(trajectories)} trajectories of this recording, trajectory "
        f"{item.row} *{item.rule}*. "
        f"The goal {'**succeeds**' if success else '**fails**'} within {seconds:.3g} s "
        f"({trajectories.horizon} steps of {simulator.control_step:g} s).\n\n"
        f"## Goal\n\n{_values(simulator.goal, goal)}\n"
        f"## Unobserved by the models\n\n"
        f"{_values(simulator.unobserved, trajectories.unobserved[item.row])}"
        "- the goal, and the noise at each step\n\n"
    )
    how = _HOW_TO_READ.format(close_up=_OF_CLOSE_UP if close_up else "")
    return text + f"## How to read it\n{how}"


def _about_recorded(simulator: Simulator, trajectories: Trajectories, item: _Selected) -> str:
    """The panel of a selected trajectory of a recorded system."""
    states, goal = trajectories.states[item.row, 1:], trajectories.goal[item.row]
    seconds = simulator.control_step * trajectories.horizon
    happened = simulator.outcomes(states, goal)
    outcomes = "".join(
        f"- {name}: **{'yes' if yes else 'no'}**\n" for name, yes in happened.items()
    )
    return (
        f"# {item.title}\n\nOf the {len(trajectories)} windows of this recording, window "
        f"{item.row} *{item.rule}* within {seconds:.3g} s ({trajectories.horizon} steps of "
        f"{simulator.control_step:g} s).\n\n"
        + (f"## Outcomes\n\n{outcomes}\n" if outcomes else "")
        + (f"## Goal\n\n{_values(simulator.goal, goal)}\n" if simulator.goal else "")
        + f"## How to read it\n{_HOW_TO_READ_RECORDED}"
    )


def _values(variables: tuple[Variable, ...], values: Floats) -> str:
    """Variables and their values as a Markdown list, since a narrow panel cuts off a table."""
    return "".join(
        f"- {v.name} = **{value:.3g} {v.unit}**, {v.meaning}\n"
        for v, value in zip(variables, values, strict=True)
    )


def _tables(simulator: Simulator, trajectories: Trajectories, distance: Distance) -> str:
    """Tables of the trajectories and of the variables, for the README panel."""
    success = simulator.outcome(trajectories.states[:, 1:], trajectories.goal)
    header = (
        "trajectory",
        *(bands.title(v) for v in simulator.unobserved),
        distance.column,
        "success",
    )
    rows = [
        (str(row), *(f"{x:.3g}" for x in unobserved), f"{closest:.3g}", "yes" if reached else "no")
        for row, (unobserved, closest, reached) in enumerate(
            zip(trajectories.unobserved, distance.extreme, success, strict=True)
        )
    ]
    variables = [
        (group, v.name, v.unit, v.meaning)
        for group in ("state", "action", "unobserved", "goal")
        for v in getattr(simulator, group)
    ]
    succeed = f"{int(success.sum())} of {len(trajectories)}"
    begin = (
        f"\n**{succeed} succeed**: they come within {simulator.radius:g} m of their target. The "
        "table shows the variables that no model observes, and the outcome:"
    )
    if not simulator.has_target:
        begin = f"\nIn **{succeed}** windows the main outcome happens:"
    return (
        f"{begin}\n\n{table(header, rows)}\n\n## Variables\n\n"
        f"{table(('', 'name', 'unit', 'meaning'), variables)}\n"
    )
