"""A filmstrip: one rollout in MuJoCo's own picture of the system, at a few times side by side."""

import copy
from dataclasses import dataclass
from pathlib import Path

import matplotlib as mpl
import mujoco
import numpy as np
from matplotlib.figure import Figure

from study.common.arrays import Booleans, Doubles, Floats, Pixels
from study.envs.rendering import drawing
from study.envs.rendering.camera import View, box, close_by, overview
from study.envs.rendering.offscreen import renderer
from study.envs.simulator import Simulator
from study.plotting import style
from study.plotting.png import WIDTH, save

Picture = Pixels

# What moves is drawn this large at least, as a share of the picture's width.
_VISIBLE = 1 / 7
# Each picture is drawn larger than it is shown, which smooths its edges.
_PIXELS = 560


@dataclass(frozen=True)
class Frames:
    """The pictures of a filmstrip.

    Attributes:
        times: [F] seconds.
        reached: [F] whether the goal has succeeded by then.
        far: [F, H, W, 3], all that happens.
        near: [F, H, W, 3], what moves alone; None where `far` shows it in its own size.
        enlarged: how many times its size what moves has in `far`.
    """

    times: Doubles
    reached: Booleans
    far: Picture
    near: Picture | None
    enlarged: int


def frames(
    simulator: Simulator, states: Floats, goal: Floats, count: int = 6, pixels: int = _PIXELS
) -> Frames:
    """Draw `count` evenly spaced states of one rollout [T+1, D], the first and last among them.

    With them: the target of `goal` [G], the sphere of success around it, and the way so far. What
    is too small to be seen beside the way it goes is enlarged, and drawn again from close by.

    Raises:
        StudyError: there is no OpenGL to draw with.
    """
    steps = np.unique(np.linspace(0, len(states) - 1, count).round().astype(int))
    path = simulator.position(states).astype(np.float64)
    target = simulator.target(goal).astype(np.float64)
    # A copy, for how far one can see is a property of the model.
    model = copy.copy(simulator.scene())
    poses = [drawing.pose(model, q) for q in simulator.configuration(states[steps])]
    bodies, size = _bodies(model, poses)

    sphere = box(target, simulator.radius)
    view = overview(model, np.concatenate([bodies, path, sphere]), path)
    enlarged = _enlargement(size / view.width)
    if enlarged > 1:
        around = np.concatenate([box(place, enlarged * size / 2) for place in path[steps]])
        view = overview(model, np.concatenate([around, path, sphere]), path)
    model.vis.map.zfar = max(model.vis.map.zfar, 20 * view.width / model.stat.extent)
    ground = drawing.ground_height(model)
    far, near = [], []
    with renderer(model, pixels, pixels) as draw:

        def picture(pose: mujoco.MjData, way: Doubles, view: View, factor: int) -> Picture:
            draw.update_scene(pose, view.camera)
            drawing.enlarge(draw.scene, way[-1], factor)
            drawing.add_path(draw.scene, way, view.width, ground)
            drawing.add_target(draw.scene, target, simulator.radius, view.width)
            return np.array(draw.render())

        for step, pose in zip(steps, poses, strict=True):
            way = path[: step + 1]
            far.append(picture(pose, way, view, enlarged))
            if enlarged > 1:
                near.append(picture(pose, way, close_by(model, way[-1], size, view), 1))
    return Frames(
        times=steps * simulator.control_step,
        reached=np.array([simulator.outcome(states[1 : step + 1], goal) for step in steps]),
        far=np.stack(far),
        near=np.stack(near) if near else None,
        enlarged=enlarged,
    )


def filmstrip(
    simulator: Simulator, states: Floats, goal: Floats, path: Path, count: int = 6
) -> Path:
    """Write the filmstrip of one rollout [T+1, D] to `path`, a PNG; see `frames`.

    Under each frame is its time in seconds; from success on the frame is green.

    Raises:
        StudyError: there is no OpenGL to draw with.
    """
    shown = frames(simulator, states, goal, count)
    rows = [("", shown.far)]
    if shown.near is not None:
        rows = [(f"drawn {shown.enlarged} × larger", shown.far), ("close by", shown.near)]
    side = WIDTH / len(shown.times)
    with mpl.rc_context(style.context()):
        figure = Figure(figsize=(WIDTH, len(rows) * side + 0.25))
        axes = figure.subplots(len(rows), len(shown.times), squeeze=False)
        for row, (name, pictures) in zip(axes, rows, strict=True):
            row[0].set_ylabel(name, fontsize=6.5)
            for axis, picture, reached in zip(row, pictures, shown.reached, strict=True):
                axis.imshow(picture, interpolation="antialiased")
                axis.set(xticks=[], yticks=[])
                axis.spines[:].set(visible=True, color="#009E73" if reached else "#BBBBBB")
                axis.spines[:].set_linewidth(1.6 if reached else 0.6)
        for axis, time, reached in zip(axes[-1], shown.times, shown.reached, strict=True):
            axis.set_xlabel(f"{time:.3g} s" + (", reached" if reached else ""))
        figure.subplots_adjust(
            0.032 if shown.enlarged > 1 else 0.004,
            0.2 / figure.get_figheight(),
            0.997,
            0.99,
            0.03,
            0.03,
        )
        return save(figure, path, dpi=250, shaded=True)


def _bodies(model: mujoco.MjModel, poses: list[mujoco.MjData]) -> tuple[Doubles, float]:
    """The corners [N, 3] of all that moves in some poses, and its size in metres."""
    moving = drawing.moving(model)
    centres = np.stack([pose.geom_xpos[moving] for pose in poses])
    reach = model.geom_rbound[moving][:, None]
    low, high = (centres - reach).min(axis=1), (centres + reach).max(axis=1)
    return np.concatenate([low, high]), float((high - low).max())


def _enlargement(share: float) -> int:
    """How many times to enlarge what has this share of the width: 1, 2, 3, 5, 10, 20, 30 …"""
    factors = [digit * 10**power for power in range(7) for digit in (1, 2, 3, 5)]
    return next((f for f in factors if f * share >= _VISIBLE), factors[-1])
