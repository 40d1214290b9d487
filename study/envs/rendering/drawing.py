"""Additions to MuJoCo's picture of a scene: the target, the path, and enlarged bodies."""

from itertools import pairwise

import mujoco
import numpy as np

from study.common.arrays import Booleans, Doubles

TARGET = (0.0, 0.62, 0.45)
PATH = (0.90, 0.50, 0.0)
GROUND = (0.1, 0.1, 0.1)

_THIN, _THICK = 0.004, 0.009
"""Widths of lines, as a share of the picture's width."""
_CIRCLE_POINTS = 48
_PATH_POINTS = 200
"""Largest number of points of a drawn path."""
_HIGH = 0.03
"""Height, as a share of the picture's width, above which a path gets a shadow on the ground."""


def pose(model: mujoco.MjModel, configuration: Doubles) -> mujoco.MjData:
    """The scene with qpos [nq]."""
    data = mujoco.MjData(model)
    data.qpos[:] = configuration
    mujoco.mj_forward(model, data)
    return data


def moving(model: mujoco.MjModel) -> Booleans:
    """Whether each geom can move, [ngeom]; it cannot if it is welded to the world."""
    return np.asarray(model.body_weldid[model.geom_bodyid] != 0)


def enlarge(scene: mujoco.MjvScene, centre: Doubles, factor: float) -> None:
    """Enlarge the moving geoms by `factor` about `centre` [3], except meshes.

    Shadows are off in an enlarged scene, since an enlarged body would cast an enlarged shadow.
    """
    scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = factor == 1
    for geom in scene.geoms[: scene.ngeom]:
        if geom.category == mujoco.mjtCatBit.mjCAT_DYNAMIC:
            geom.pos[:] = centre + factor * (geom.pos - centre)
            geom.size[:] = factor * geom.size


def add_target(scene: mujoco.MjvScene, target: Doubles, radius: float, width: float) -> None:
    """Add the goal region, a translucent sphere around `target` [3], and its equator."""
    _add(scene, mujoco.mjtGeom.mjGEOM_SPHERE, np.full(3, radius), target, (*TARGET, 0.3))
    angle = np.linspace(0.0, 2 * np.pi, _CIRCLE_POINTS + 1)
    circle = target + radius * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=-1)
    _add_line(scene, circle, _THICK * width, (*TARGET, 1.0))


def add_path(
    scene: mujoco.MjvScene, path: Doubles, width: float, ground: float | None = None
) -> None:
    """Add a path [t, 3]; high above the ground, also a plumb line and a shadow on the ground."""
    chosen = np.linspace(0, len(path) - 1, min(len(path), _PATH_POINTS)).round().astype(int)
    path = path[chosen]
    _add_line(scene, path, _THICK * width, (*PATH, 0.9))
    if ground is not None and path[:, 2].max() - ground > _HIGH * width:
        shadow = np.column_stack([path[:, :2], np.full(len(path), ground)])
        _add_line(scene, shadow, _THIN * width, (*GROUND, 0.5))
        _add_line(scene, np.stack([path[-1], shadow[-1]]), _THIN * width, (*GROUND, 0.5))


def ground_height(model: mujoco.MjModel) -> float | None:
    """Height of the scene's ground, a fixed horizontal plane; None without one."""
    planes = (model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE) & ~moving(model)
    return float(model.geom_pos[planes, 2].max()) if planes.any() else None


def _add_line(
    scene: mujoco.MjvScene, points: Doubles, width: float, colour: tuple[float, ...]
) -> None:
    for start, end in pairwise(points):
        kind = mujoco.mjtGeom.mjGEOM_CAPSULE
        geom = _add(scene, kind, np.zeros(3), np.zeros(3), colour)
        mujoco.mjv_connector(geom, kind, width / 2, start, end)


def _add(
    scene: mujoco.MjvScene,
    kind: mujoco.mjtGeom,
    size: Doubles,
    position: Doubles,
    colour: tuple[float, ...],
) -> mujoco.MjvGeom:
    geom = scene.geoms[scene.ngeom]
    rotation, rgba = np.eye(3).ravel(), np.array(colour, np.float32)
    mujoco.mjv_initGeom(geom, kind, size, position, rotation, rgba)
    # Without a shadow, and visible without light.
    geom.category = mujoco.mjtCatBit.mjCAT_DECOR
    geom.emission, geom.specular = 0.3, 0.0
    scene.ngeom += 1
    return geom
