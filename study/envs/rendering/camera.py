"""Cameras that have a whole path in the picture."""

from dataclasses import dataclass

import mujoco
import numpy as np

from study.common.arrays import Doubles

CAMERA = "portrait"
"""Name of a model's own camera. A model without it gets a fitted camera."""

_MARGIN = 0.08
"""Empty border, as a share of half the picture."""
_FLAT, _SPATIAL, _CLOSE = 75.0, 20.0, 15.0
"""Degrees above the horizon for motion in a plane, motion in space, and a close-up."""


@dataclass(frozen=True)
class View:
    """A camera, and the width of its picture in metres at its focal point."""

    camera: mujoco.MjvCamera
    width: float


def overview(model: mujoco.MjModel, points: Doubles, path: Doubles) -> View:
    """A view with all points in a square picture.

    It shows motion in a plane from above, with north up, and motion in space from the side, across
    the main direction of the path.

    Args:
        model: the scene.
        points: [N, 3].
        path: [T, 3].
    """
    identity = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_CAMERA, CAMERA)
    if identity >= 0:
        return _named(model, identity, points)
    level = float(np.hypot(*np.ptp(points, axis=0)[:2]))
    flat = float(np.ptp(path[:, 2])) < 0.02 * level
    azimuth, elevation = (90.0, _FLAT) if flat else (_across(path), _SPATIAL)
    return _fitted(model, points, azimuth, elevation)


def close_by(model: mujoco.MjModel, position: Doubles, size: float, far: View) -> View:
    """A view of `size` metres around `position` [3], from the direction of the view `far`."""
    azimuth = far.camera.azimuth if far.camera.type == mujoco.mjtCamera.mjCAMERA_FREE else 90.0
    return _fitted(model, box(position, 0.6 * size), azimuth, _CLOSE)


def box(centre: Doubles, reach: float) -> Doubles:
    """Points [6, 3] at `reach` metres from `centre` [3] along the axes, on both sides."""
    return np.asarray(centre + reach * np.concatenate([np.eye(3), -np.eye(3)]))


def _fitted(model: mujoco.MjModel, points: Doubles, azimuth: float, elevation: float) -> View:
    camera = mujoco.MjvCamera()
    camera.type = mujoco.mjtCamera.mjCAMERA_FREE
    camera.lookat[:] = (points.min(axis=0) + points.max(axis=0)) / 2
    camera.azimuth, camera.elevation = azimuth, -elevation
    pan, tilt = np.deg2rad(azimuth), np.deg2rad(elevation)
    forward = np.array([np.cos(tilt) * np.cos(pan), np.cos(tilt) * np.sin(pan), -np.sin(tilt)])
    right = np.array([np.sin(pan), -np.cos(pan), 0.0])
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
    """Azimuth in degrees of a camera that looks across the main direction of the path."""
    level = path[:, :2] - path[:, :2].mean(axis=0)
    if not level.any():
        return 90.0
    east, north = np.linalg.svd(level, full_matrices=False)[2][0]
    azimuth = float(np.rad2deg(np.arctan2(north, east))) + 90.0
    return (azimuth % 180.0) or 180.0
