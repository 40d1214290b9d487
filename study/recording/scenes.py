"""MuJoCo scenes in Rerun: the shapes of a model once, its bodies' motion along a timeline.

The entities mirror the model: `root/body/geom`. A body carries the transform (to the world's frame),
its geoms lie in the body's frame.
"""

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
import rerun as rr
from numpy.typing import ArrayLike, NDArray

from study.recording.streams import entity_path, time_column

# MuJoCo's viewer hides groups 3 to 5 too: that is where collision shapes are kept.
_VISIBLE_GROUPS = range(3)
_THICKNESS = 1e-3


def moving_bodies(model: mujoco.MjModel) -> list[int]:
    """The bodies that some joint can move."""
    return [body for body in range(model.nbody) if model.body_weldid[body] != 0]


def fixed_bodies(model: mujoco.MjModel) -> list[int]:
    """The world, and whatever is welded to it."""
    return [body for body in range(model.nbody) if model.body_weldid[body] == 0]


def log_bodies(
    stream: rr.RecordingStream, root: str, model: mujoco.MjModel, bodies: Sequence[int]
) -> None:
    """The visible geoms of some bodies, for all time, in the bodies' frames."""
    for geom in range(model.ngeom):
        body = int(model.geom_bodyid[geom])
        colour = _colour(model, geom)
        if body in bodies and model.geom_group[geom] in _VISIBLE_GROUPS and colour[3] > 0:
            shape = _shape(model, geom, colour)
            if shape is not None:
                name = model.geom(geom).name or f"geom_{geom}"
                stream.log(_body_path(root, model, body, name), shape, static=True)


def log_motion(
    stream: rr.RecordingStream,
    root: str,
    model: mujoco.MjModel,
    bodies: Sequence[int],
    qpos: ArrayLike,
    timeline: str,
    times: ArrayLike,
) -> None:
    """Where some bodies are at each of the N times, from MuJoCo's qpos [N, nq]."""
    positions, rotations = body_poses(model, np.atleast_2d(np.asarray(qpos, dtype=np.float64)))
    for body in bodies:
        columns = rr.Transform3D.columns(
            translation=positions[:, body], quaternion=rotations[:, body]
        )
        path = _body_path(root, model, body)
        stream.send_columns(path, [time_column(timeline, times)], columns)


def log_poses(
    stream: rr.RecordingStream,
    root: str,
    model: mujoco.MjModel,
    bodies: Sequence[int],
    qpos: ArrayLike,
) -> None:
    """Where some bodies are for all time, from one qpos [nq]."""
    positions, rotations = body_poses(model, np.atleast_2d(np.asarray(qpos, dtype=np.float64)))
    for body in bodies:
        pose = rr.Transform3D(
            translation=positions[0, body], quaternion=rr.Quaternion(xyzw=rotations[0, body])
        )
        stream.log(_body_path(root, model, body), pose, static=True)


def body_poses(
    model: mujoco.MjModel, qpos: NDArray[np.float64]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """World positions [N, B, 3] and rotations [N, B, 4] (xyzw) of all bodies for qpos [N, nq]."""
    data = mujoco.MjData(model)
    positions = np.empty((len(qpos), model.nbody, 3), dtype=np.float32)
    rotations = np.empty((len(qpos), model.nbody, 4), dtype=np.float32)
    for row, configuration in enumerate(qpos):
        data.qpos[:] = configuration
        mujoco.mj_kinematics(model, data)
        positions[row] = data.xpos
        rotations[row] = xyzw(data.xquat)
    return positions, rotations


def xyzw(quaternions: NDArray[Any]) -> NDArray[Any]:
    """MuJoCo's quaternions [..., 4] (w first) as Rerun's (w last)."""
    return np.roll(quaternions, -1, axis=-1)


def _body_path(root: str, model: mujoco.MjModel, body: int, *below: str) -> str:
    parts = [part for part in root.split("/") if part]
    return entity_path(*parts, model.body(body).name or f"body_{body}", *below)


def _colour(model: mujoco.MjModel, geom: int) -> NDArray[np.uint8]:
    material = int(model.geom_matid[geom])
    rgba = model.geom_rgba[geom] if material < 0 else model.mat_rgba[material]
    return np.asarray(np.clip(rgba, 0, 1) * 255, dtype=np.uint8)


def _shape(
    model: mujoco.MjModel, geom: int, colour: NDArray[np.uint8]
) -> rr.AsComponents | None:
    """One geom in its body's frame. Height fields and signed distance fields are left out."""
    size, position = model.geom_size[geom], model.geom_pos[geom]
    quaternion = rr.Quaternion(xyzw=xyzw(model.geom_quat[geom]))
    look: dict[str, Any] = {
        "colors": [colour],
        "quaternions": [quaternion],
        "fill_mode": rr.components.FillMode.Solid,
    }
    match mujoco.mjtGeom(model.geom_type[geom]):
        case mujoco.mjtGeom.mjGEOM_PLANE:
            # Size 0 means endless: drawn as far as the rest of the model reaches.
            half = np.where(size[:2] > 0, size[:2], 3 * model.stat.extent)
            return rr.Boxes3D(half_sizes=[[*half, _THICKNESS]], centers=[position], **look)
        case mujoco.mjtGeom.mjGEOM_BOX:
            return rr.Boxes3D(half_sizes=[size], centers=[position], **look)
        case mujoco.mjtGeom.mjGEOM_SPHERE:
            return rr.Ellipsoids3D(half_sizes=[[size[0]] * 3], centers=[position], **look)
        case mujoco.mjtGeom.mjGEOM_ELLIPSOID:
            return rr.Ellipsoids3D(half_sizes=[size], centers=[position], **look)
        case mujoco.mjtGeom.mjGEOM_CYLINDER:
            return rr.Cylinders3D(
                lengths=[2 * size[1]], radii=[size[0]], centers=[position], **look
            )
        case mujoco.mjtGeom.mjGEOM_CAPSULE:
            start = capsule_start(position, model.geom_quat[geom], float(size[1]))
            return rr.Capsules3D(
                lengths=[2 * size[1]], radii=[size[0]], translations=[start], **look
            )
        case mujoco.mjtGeom.mjGEOM_MESH:
            return _mesh(model, geom, colour)
        case _:
            return None


def capsule_start(
    centre: NDArray[np.float64], quaternion: NDArray[np.float64], half_length: float
) -> NDArray[np.float64]:
    """Rerun's capsule runs from z = 0 to its length, MuJoCo's from −half to +half of its length."""
    offset = np.zeros(3)
    mujoco.mju_rotVecQuat(offset, np.array([0.0, 0.0, -half_length]), quaternion)
    return np.asarray(centre + offset)


def _mesh(model: mujoco.MjModel, geom: int, colour: NDArray[np.uint8]) -> rr.Mesh3D:
    mesh = int(model.geom_dataid[geom])
    vertices = model.mesh_vert[model.mesh_vertadr[mesh] :][: model.mesh_vertnum[mesh]]
    faces = model.mesh_face[model.mesh_faceadr[mesh] :][: model.mesh_facenum[mesh]]
    rotation = np.empty(9)
    mujoco.mju_quat2Mat(rotation, model.geom_quat[geom])
    placed = vertices @ rotation.reshape(3, 3).T + model.geom_pos[geom]
    return rr.Mesh3D(
        vertex_positions=placed, triangle_indices=faces, albedo_factor=rr.AlbedoFactor(colour)
    )
