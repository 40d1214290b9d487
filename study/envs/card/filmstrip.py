"""A filmstrip: MuJoCo's pictures of one rollout at a few times, side by side."""

import copy
from dataclasses import dataclass
from pathlib import Path

import matplotlib as mpl
import mujoco
import numpy as np
from matplotlib.figure import Figure

from study.common.arrays import Booleans, Doubles, Floats, Pixels
from study.common.errors import StudyError
from study.envs.rendering import drawing
from study.envs.rendering.camera import View, box, close_by, overview
from study.envs.rendering.offscreen import renderer
from study.envs.simulator import Simulator
from study.plotting import style
from study.plotting.png import WIDTH, save

_SMALLEST_SHARE = 1 / 7
"""Smallest size of the moving bodies, as a share of the picture's width."""
_PIXELS = 560
"""Side of a rendered picture. The figure shows it smaller, which smooths its edges."""


@dataclass(frozen=True)
class Frames:
    """The F pictures of a filmstrip.

    Attributes:
        times: [F] seconds.
        reached: [F] whether the goal has been reached.
        far: [F, H, W, 3] pictures of the whole path.
        near: [F, H, W, 3] close-ups of the moving bodies; None if `far` shows them in true size.
        enlarged: factor by which the moving bodies are enlarged in `far`.
    """

    times: Doubles
    reached: Booleans
    far: Pixels
    near: Pixels | None
    enlarged: int


def frames(
    simulator: Simulator, states: Floats, goal: Floats, count: int = 6, pixels: int = _PIXELS
) -> Frames:
    """Render evenly spaced states of one rollout, the first and the last among them.

    The pictures show the goal region around the target, and the path so far. If the moving bodies
    are too small beside the path, the pictures show them enlarged, and close-ups in true size.

    Args:
        simulator: the system.
        states: [T+1, D].
        goal: [G].
        count: number of pictures F.
        pixels: side of a picture.

    Raises:
        StudyError: the system has no scene, or OpenGL is not available.
    """
    scene = simulator.scene()
    if scene is None:
        raise StudyError(f"{simulator.title} has no MuJoCo scene and cannot be drawn")
    steps = np.unique(np.linspace(0, len(states) - 1, count).round().astype(int))
    path = simulator.position(states).astype(np.float64)
    target = simulator.target(goal).astype(np.float64)
    # A copy, since the visible range is set in the model.
    model = copy.copy(scene)
    poses = [drawing.pose(model, q) for q in simulator.configuration(states[steps])]
    bodies, size = _bodies(model, poses)

    sphere = box(target, simulator.radius)
    view = overview(model, np.concatenate([bodies, path, sphere]), path)
    enlarged = _enlargement(size / view.width)
    if enlarged > 1:
        around = np.concatenate([box(point, enlarged * size / 2) for point in path[steps]])
        view = overview(model, np.concatenate([around, path, sphere]), path)
    model.vis.map.zfar = max(model.vis.map.zfar, 20 * view.width / model.stat.extent)
    ground = drawing.ground_height(model)
    far, near = [], []
    with renderer(model, pixels, pixels) as draw:

        def picture(pose: mujoco.MjData, travelled: Doubles, view: View, factor: int) -> Pixels:
            draw.update_scene(pose, view.camera)
            drawing.enlarge(draw.scene, travelled[-1], factor)
            drawing.add_path(draw.scene, travelled, view.width, ground)
            drawing.add_target(draw.scene, target, simulator.radius, view.width)
            return np.array(draw.render())

        for step, pose in zip(steps, poses, strict=True):
            travelled = path[: step + 1]
            far.append(picture(pose, travelled, view, enlarged))
            if enlarged > 1:
                near.append(picture(pose, travelled, close_by(model, travelled[-1], size, view), 1))
    return Frames(
        times=steps * simulator.control_step,
        reached=np.array([simulator.outcome(states[1 : step + 1], goal) for step in steps]),
        far=np.stack(far),
        near=np.stack(near) if near else None,
        enlarged=enlarged,
    )


def plot_filmstrip(
    simulator: Simulator, states: Floats, goal: Floats, path: Path, count: int = 6
) -> Path:
    """Plot the filmstrip of one rollout to a PNG file; arguments as of `frames`.

    The label of a picture is its time. Its frame is green once the goal is reached.

    Raises:
        StudyError: OpenGL is not available.
    """
    strip = frames(simulator, states, goal, count)
    rows = [("", strip.far)]
    if strip.near is not None:
        rows = [(f"enlarged {strip.enlarged} ×", strip.far), ("close-up", strip.near)]
    side = WIDTH / len(strip.times)
    with mpl.rc_context(style.context()):
        figure = Figure(figsize=(WIDTH, len(rows) * side + 0.25))
        axes = figure.subplots(len(rows), len(strip.times), squeeze=False)
        for row, (name, pictures) in zip(axes, rows, strict=True):
            row[0].set_ylabel(name, fontsize=6.5)
            for axis, picture, reached in zip(row, pictures, strip.reached, strict=True):
                axis.imshow(picture, interpolation="antialiased")
                axis.set(xticks=[], yticks=[])
                axis.spines[:].set(visible=True, color="#009E73" if reached else "#BBBBBB")
                axis.spines[:].set_linewidth(1.6 if reached else 0.6)
        for axis, time, reached in zip(axes[-1], strip.times, strip.reached, strict=True):
            axis.set_xlabel(f"{time:.3g} s" + (", reached" if reached else ""))
        figure.subplots_adjust(
            0.032 if strip.enlarged > 1 else 0.004,
            0.2 / figure.get_figheight(),
            0.997,
            0.99,
            0.03,
            0.03,
        )
        return save(figure, path, dpi=250, shaded=True)


def _bodies(model: mujoco.MjModel, poses: list[mujoco.MjData]) -> tuple[Doubles, float]:
    """Corners [N, 3] of the moving bodies in some poses, and the bodies' size in metres."""
    moving = drawing.moving(model)
    centres = np.stack([pose.geom_xpos[moving] for pose in poses])
    reach = model.geom_rbound[moving][:, None]
    low, high = (centres - reach).min(axis=1), (centres + reach).max(axis=1)
    return np.concatenate([low, high]), float((high - low).max())


def _enlargement(share: float) -> int:
    """The factor 1, 2, 3, 5, 10, 20 … that brings a share of the width to the smallest one."""
    factors = [digit * 10**power for power in range(7) for digit in (1, 2, 3, 5)]
    return next((factor for factor in factors if factor * share >= _SMALLEST_SHARE), factors[-1])
