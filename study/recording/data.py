"""The recording of training data: what a model learns from, trajectory by trajectory."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from study.common.arrays import Array, Doubles, Floats
from study.data.trajectories import Trajectories
from study.plotting.palette import NOW, OBSERVED, TARGET, faint
from study.recording import bands, blueprints, fans, scenes
from study.recording.properties import Properties, table, write_markdown, write_readme
from study.recording.streams import (
    entity_path,
    finite,
    recording,
    send_scalars,
    style_lines,
    time_column,
)

if TYPE_CHECKING:
    from study.envs.simulator import Simulator, Variable

KIND = "data"
TIMELINE = "step"
# Bodies that are smaller than this share of what the paths span need a view of their own.
_TINY = 0.02
# In the scene, where lines that are not opaque come out black.
_OTHERS = (120, 120, 120, 255)
# So many plots of signals stand on a page.
_PAGE = 8

_README = """
# Training data

What the models of this environment learn from: trajectories of the real system, each with a
beginning, a target and noise of its own. Actions are planned without noise, then executed in it.
Each of the first tabs follows one trajectory through the scene; **grey** are all the others here.
"""
_HOW_TO_READ = """
**Orange** is this trajectory, **grey** are the others of this recording.

- *3D*: the paths; the orange dot, and the scene, are where the trajectory is at the time cursor.
  **Green** is its target and how close to it counts as success; green dots are the others' targets.
{close_up}- *Distance*: success is to come below the green line.
- *Signals*: actions are what the model is told, states what it has to forecast.
"""
_OF_CLOSE_UP = "- *Close-up*: the bodies alone, at the cursor; the view moves along.\n"


@dataclass(frozen=True)
class _Chosen:
    """A trajectory to look at closely: its row, the tab's title, and why it was chosen."""

    row: int
    title: str
    rule: str

    @property
    def root(self) -> str:
        return entity_path(self.title.lower().replace(" ", "_"))


def record_data(
    path: Path, simulator: "Simulator", trajectories: Trajectories, properties: Properties
) -> None:
    """Write the recording of some trajectories: about 20 are enough to see how they vary.

    `/state/NAME` and `/action/NAME` hold a column a trajectory on the timeline `step`, an action
    at the step it starts from; `/unobserved/NAME` a row a trajectory on the timeline `trajectory`.
    Whatever is not finite is left out.
    """
    paths = simulator.position(trajectories.states).astype(np.float32)
    targets = np.asarray(simulator.target(trajectories.goal), dtype=np.float32)
    distance = finite(np.linalg.norm(paths - targets[:, None], axis=-1))
    chosen = _choose(distance)
    model = simulator.scene()
    close_up = _close_up(model, paths)
    design = _design(simulator, chosen, paths, targets, close_up)
    with recording(path, KIND, properties, design, footer=False) as stream:
        write_readme(stream, _README + _tables(simulator, trajectories, distance), properties)
        fixed = scenes.fixed_bodies(model)
        scenes.log_bodies(stream, "/scene", model, fixed)
        pose = simulator.configuration(trajectories.states[0, 0])
        scenes.log_poses(stream, "/scene", model, fixed, pose)
        fans.log_fan(stream, "/paths/all", paths, _OTHERS)
        dots = rr.Points3D(targets, colors=[faint(TARGET, 150)], radii=rr.Radius.ui_points(3.0))
        stream.log("/paths/targets", dots, static=True)
        _log_signals(stream, simulator, trajectories, distance, chosen)
        for one in chosen:
            about = _about(simulator, trajectories, one, close_up is not None)
            write_markdown(stream, f"{one.root}/about", about)
            fans.log_target(stream, f"{one.root}/paths/target", targets[one.row], simulator.radius)
            _log_run(stream, one.root, simulator, model, trajectories.states[one.row])


def _choose(distance: Doubles) -> list[_Chosen]:
    """The trajectories that come closest to, and stay farthest from, their targets; the median."""
    closest = np.nanmin(np.where(np.isnan(distance), np.inf, distance), axis=1)
    order = np.argsort(closest, kind="stable")
    rules = (
        (order[0], "Closest", "comes closest to its target"),
        (order[len(order) // 2], "Median", "comes as close to its target as the median"),
        (order[-1], "Farthest", "stays farthest from its target"),
    )
    picked: dict[int, _Chosen] = {}
    for row, title, rule in rules:
        picked.setdefault(int(row), _Chosen(int(row), title, rule))
    return list(picked.values())


def _design(
    simulator: "Simulator",
    chosen: list[_Chosen],
    paths: Floats,
    targets: Floats,
    close_up: rrb.EyeControls3D | None,
) -> rrb.Blueprint:
    plotted = tuple(v for v in simulator.state if v.name in simulator.plotted)
    others = tuple(v for v in simulator.state if v.name not in simulator.plotted)
    pages = {
        "Actions, and what they do" if plotted else "Actions": [
            *_signals("action", simulator.action),
            *_signals("state", plotted),
        ]
    }
    state = _signals("state", others)
    count = -(-len(state) // _PAGE)
    for page in range(count):
        part = state[page * len(state) // count : (page + 1) * len(state) // count]
        pages[f"State {page + 1}" if count > 1 else "State"] = part
    # Large bodies must stay in sight wherever they move, small ones are lost among all the paths.
    eyes = {
        one.root: fans.eye(paths if close_up is None else paths[one.row], targets[one.row])
        for one in chosen
    }
    return blueprints.data({one.title: one.root for one in chosen}, pages, eyes, close_up)


def _signals(group: str, variables: tuple["Variable", ...]) -> list[tuple[str, str]]:
    """Title and entity of each variable's plot; an action may have the name of a state."""
    return [(f"{group} {bands.title(v)}", entity_path(group, v.name)) for v in variables]


def _close_up(model: Any, paths: Floats) -> rrb.EyeControls3D | None:
    """An eye close to bodies that are too small to be seen beside their paths, or none."""
    moving = scenes.moving_bodies(model)
    points = paths.reshape(-1, 3)
    points = points[np.isfinite(points).all(axis=1)]
    if not moving or not len(points):
        return None
    geoms = np.isin(model.geom_bodyid, moving)
    if not geoms.any():
        return None
    away = np.linalg.norm(model.geom_pos[geoms], axis=1) + model.geom_rbound[geoms]
    size = float(away.max())
    if size > _TINY * float(np.ptp(points, axis=0).max()):
        return None
    return rrb.EyeControls3D(
        kind=rrb.Eye3DKind.Orbital,
        position=2.5 * size * np.array([-0.5, -1.0, 0.6]),
        look_target=(0, 0, 0),
        eye_up=(0, 0, 1),
    )


def _log_signals(
    stream: rr.RecordingStream,
    simulator: "Simulator",
    trajectories: Trajectories,
    distance: Doubles,
    chosen: list[_Chosen],
) -> None:
    """Each signal of all trajectories, a column each; and once more that of those looked at."""
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
        for one in chosen:
            own = f"{one.root}/{entity.strip('/')}"
            style_lines(stream, own, [f"trajectory {one.row}"], [NOW], 2.5)
            send_scalars(stream, own, TIMELINE, steps, values[one.row])
    steps = np.arange(trajectories.horizon + 1)
    style_lines(stream, "radius", ["success"], [TARGET], 2.0)
    send_scalars(stream, "radius", TIMELINE, steps, np.full(len(steps), simulator.radius))
    for column, variable in enumerate(simulator.unobserved):
        rows, drawn = np.arange(len(trajectories)), finite(trajectories.unobserved[:, column])
        send_scalars(stream, entity_path("unobserved", variable.name), "trajectory", rows, drawn)


def _log_run(
    stream: rr.RecordingStream,
    root: str,
    simulator: "Simulator",
    model: Any,
    states: Floats,
) -> None:
    """One trajectory [T+1, D] in the scene: its path, its dot, and the bodies' motion."""
    lost = ~np.isfinite(states).all(axis=-1)
    states = states[: max(1, int(lost.argmax()))] if lost.any() else states
    path = simulator.position(states).astype(np.float32)
    steps = np.arange(len(states))
    line = rr.LineStrips3D([path], colors=[NOW], radii=rr.Radius.ui_points(2.0))
    stream.log(f"{root}/paths/run", line, static=True)
    look = rr.Points3D.from_fields(colors=[NOW], radii=rr.Radius.ui_points(6.0))
    stream.log(f"{root}/paths/now", look, static=True)
    # Told to track an entity, the eye stays where it is in a viewer without a window. So the view's
    # origin moves, but does not turn: the bodies are seen to tilt.
    frame = rr.Transform3D.columns(translation=path)
    stream.send_columns(f"{root}/{blueprints.FOLLOW}", [time_column(TIMELINE, steps)], frame)
    dots = rr.Points3D.columns(positions=path)
    stream.send_columns(f"{root}/paths/now", [time_column(TIMELINE, steps)], dots)
    moving = scenes.moving_bodies(model)
    scenes.log_bodies(stream, f"{root}/scene", model, moving)
    qpos = simulator.configuration(states)
    scenes.log_motion(stream, f"{root}/scene", model, moving, qpos, TIMELINE, steps)


def _about(simulator: "Simulator", trajectories: Trajectories, one: _Chosen, close_up: bool) -> str:
    """What there is to know of one trajectory, and how to read its views."""
    states, goal = trajectories.states[one.row], trajectories.goal[one.row]
    success = bool(simulator.outcome(states[1:], goal))
    seconds = simulator.control_step * trajectories.horizon
    text = (
        f"# {one.title}\n\nTrajectory {one.row}: of the {len(trajectories)} here it *{one.rule}*. "
        f"It {'**succeeds**' if success else 'does **not succeed**'} within {seconds:.3g} s "
        f"({trajectories.horizon} steps of {simulator.control_step:g} s).\n\n"
        f"## What was asked for\n\n{_values(simulator.goal, goal)}\n"
        f"## What no model sees\n\n{_values(simulator.unobserved, trajectories.unobserved[one.row])}"
        "- the target, and the noise at each step\n\n"
    )
    how = _HOW_TO_READ.format(close_up=_OF_CLOSE_UP if close_up else "")
    return text + f"## How to read it\n{how}"


def _values(variables: tuple["Variable", ...], values: Floats) -> str:
    """A list of variables with their values, which wraps where a table would be cut off."""
    return "".join(
        f"- {v.name} = **{value:.3g} {v.unit}**, {v.meaning}\n"
        for v, value in zip(variables, values, strict=True)
    )


def _tables(simulator: "Simulator", trajectories: Trajectories, distance: Doubles) -> str:
    """The trajectories, and the variables, as tables for the README panel."""
    success = simulator.outcome(trajectories.states[:, 1:], trajectories.goal)
    closest = np.nanmin(np.where(np.isnan(distance), np.inf, distance), axis=1)
    header = (
        "trajectory",
        *(bands.title(v) for v in simulator.unobserved),
        "closest [m]",
        "success",
    )
    rows = [
        (str(row), *(f"{x:.3g}" for x in unobserved), f"{near:.3g}", "yes" if reached else "no")
        for row, (unobserved, near, reached) in enumerate(
            zip(trajectories.unobserved, closest, success, strict=True)
        )
    ]
    variables = [
        (group, v.name, v.unit, v.meaning)
        for group in ("state", "action", "unobserved", "goal")
        for v in getattr(simulator, group)
    ]
    return (
        f"\n**{int(success.sum())} of {len(trajectories)} succeed**: they come within "
        f"{simulator.radius:g} m of their target. What is unobserved from models:\n\n"
        f"{table(header, rows)}\n\n## Variables\n\n"
        f"{table(('', 'name', 'unit', 'meaning'), variables)}\n"
    )
