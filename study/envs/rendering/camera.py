"""Where to look at a scene from, so that all that happens is in the picture."""

from dataclasses import dataclass

import mujoco
import numpy as np

from study.common.arrays import Doubles

CAMERA = "portrait"
"""A camera of this name in a model is used instead of a fitted one."""

# Share of half a picture that is left empty on either side.
_MARGIN = 0.08
# Degrees above the horizon: motion in a plane is seen best from above, in space from the side.
_FLAT, _SPATIAL, _CLOSE = 75.0, 20.0, 15.0


@dataclass(frozen=True)
class View:
    """A camera and how wide the picture is, in metres, at the point that it looks at."""

    camera: mujoco.MjvCamera
    width: float


def overview(model: mujoco.MjModel, points: Doubles, path: Doubles) -> View:
    """A square picture of all `points` [N, 3].

    What moves in a plane is seen from above, north up; what moves in space more from the side,
    looking across the main direction of `path` [T, 3].
    """
    identity = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_CAMERA, CAMERA)
    if identity >= 0:
        return _named(model, identity, points)
    level = float(np.hypot(*np.ptp(points, axis=0)[:2]))
    flat = float(np.ptp(path[:, 2])) < 0.02 * level
    azimuth, elevation = (90.0, _FLAT) if flat else (_across(path), _SPATIAL)
    return _fitted(model, points, azimuth, elevation)


def close_by(model: mujoco.MjModel, position: Doubles, size: float, far: View) -> View:
    """A square picture of `size` metres around `position` [3], from where `far` looks."""
    azimuth = far.camera.azimuth if far.camera.type == mujoco.mjtCamera.mjCAMERA_FREE else 90.0
    return _fitted(model, box(position, 0.6 * size), azimuth, _CLOSE)


def box(centre: Doubles, reach: float) -> Doubles:
    """Points [6, 3] that are `reach` metres from `centre` [3] along the axes."""
    return np.asarray(centre + reach * np.concatenate([np.eye(3), -np.eye(3)]))


def _fitted(model: mujoco.MjModel, points: Doubles, azimuth: float, elevation: float) -> View:
    camera = mujoco.MjvCamera()
    camera.type = mujoco.mjtCamera.mjCAMERA_FREE
    camera.lookat[:] = (points.min(axis=0) + points.max(axis=0)) / 2
    camera.azimuth, camera.elevation = azimuth, -elevation
    turn, tilt = np.deg2rad(azimuth), np.deg2rad(elevation)
    forward = np.array([np.cos(tilt) * np.cos(turn), np.cos(tilt) * np.sin(turn), -np.sin(tilt)])
    right = np.array([np.sin(turn), -np.cos(turn), 0.0])
    axes = np.stack([right, np.cross(right, forward), forward])
    slope = np.tan(np.deg2rad(model.vis.global_.fovy) / 2)
    across, up, depth = axes @ (points - camera.lookat).T
    # A point is in the picture if |across| and |up| are below (distance + depth) * slope.
    needed = np.maximum(np.abs(across), np.abs(up)) / (slope * (1 - _MARGIN)) - depth
    camera.distance = max(float(needed.max()), 1e-3)
    return View(camera, 2 * camera.distance * slope)


def _named(model: mujoco.MjModel, identity: int, points: Doubles) -> View:
    camera = mujoco.MjvCamera()
    camera.type = mujoco.mjtCamera.mjCAMERA_FIXED
    camera.fixedcamid = identity
    centre = (points.min(axis=0) + points.max(axis=0)) / 2
    distance = float(np.linalg.norm(model.cam_pos[identity] - centre))
    slope = np.tan(np.deg2rad(model.cam_fovy[identity]) / 2)
    return View(camera, 2 * distance * slope)


def _across(path: Doubles) -> float:
    """The azimuth in degrees, northwards if it can be, that sees the path's length sideways."""
    level = path[:, :2] - path[:, :2].mean(axis=0)
    if not level.any():
        return 90.0
    east, north = np.linalg.svd(level, full_matrices=False)[2][0]
    azimuth = float(np.rad2deg(np.arctan2(north, east))) + 90.0
    return (azimuth % 180.0) or 180.0
