"""MuJoCo scenes in Rerun: static shapes, and the motion of the bodies over a timeline.

The entities follow the model: `root/body/kind of geom`. The entity of a body holds the transform to
the world's frame. The geoms are in the frame of their body.
"""

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
import rerun as rr
from numpy.typing import ArrayLike

from study.common.arrays import Array, Doubles, Floats, Pixels
from study.envs.simulator import Simulator
from study.recording.streams import entity_below, time_column

# By convention groups 3 to 5 are collision shapes. MuJoCo's viewer hides them too.
_VISIBLE_GROUPS = range(3)
_THICKNESS = 1e-3
# The kind of shape in Rerun of each type of geom. Height fields and distance fields are ignored.
_KINDS = {
    int(mujoco.mjtGeom.mjGEOM_PLANE): "planes",
    int(mujoco.mjtGeom.mjGEOM_BOX): "boxes",
    int(mujoco.mjtGeom.mjGEOM_SPHERE): "ellipsoids",
    int(mujoco.mjtGeom.mjGEOM_ELLIPSOID): "ellipsoids",
    int(mujoco.mjtGeom.mjGEOM_CYLINDER): "cylinders",
    int(mujoco.mjtGeom.mjGEOM_CAPSULE): "capsules",
    int(mujoco.mjtGeom.mjGEOM_MESH): "meshes",
}


def moving_bodies(model: mujoco.MjModel) -> list[int]:
    """The numbers of the bodies that a joint can move."""
    return [body for body in range(model.nbody) if model.body_weldid[body] != 0]


def fixed_bodies(model: mujoco.MjModel) -> list[int]:
    """The numbers of the world and of the bodies that are fixed to the world."""
    return [body for body in range(model.nbody) if model.body_weldid[body] == 0]


def log_fixed(
    stream: rr.RecordingStream, simulator: Simulator, model: mujoco.MjModel | None, state: Floats
) -> None:
    """Log the bodies that do not move, below `/scene`, in the pose of a state [D].

    The function does nothing if the system has no scene.
    """
    if model is not None:
        fixed = fixed_bodies(model)
        log_bodies(stream, "/scene", model, fixed)
        log_poses(stream, "/scene", model, fixed, simulator.configuration(state))


def log_moving(
    stream: rr.RecordingStream,
    root: str,
    simulator: Simulator,
    model: mujoco.MjModel | None,
    states: Floats,
    timeline: str,
) -> None:
    """Log the bodies that move, and their motion along states [N, D] at the times 0 to N − 1.

    The function does nothing if the system has no scene.
    """
    if model is not None:
        moving = moving_bodies(model)
        log_bodies(stream, root, model, moving)
        qpos = simulator.configuration(states)
        log_motion(stream, root, model, moving, qpos, timeline, np.arange(len(states)))


def log_bodies(
    stream: rr.RecordingStream, root: str, model: mujoco.MjModel, bodies: Sequence[int]
) -> None:
    """Log the visible geoms of `bodies` as static shapes in the frames of their bodies.

    Geoms of one kind and body share an entity such as `root/body/boxes`, since an entity takes
    kilobytes.
    """
    for body in bodies:
        kinds: dict[str, list[int]] = {}
        for geom in map(int, np.flatnonzero(model.geom_bodyid == body)):
            if model.geom_group[geom] in _VISIBLE_GROUPS and _colour(model, geom)[3] > 0:
                kinds.setdefault(_KINDS.get(int(model.geom_type[geom]), ""), []).append(geom)
        kinds.pop("", None)
        for mesh in kinds.pop("meshes", []):
            stream.log(
                _body_path(root, model, body, f"mesh_{mesh}"), _mesh(model, mesh), static=True
            )
        for kind, geoms in kinds.items():
            shapes = _shapes(model, kind, geoms)
            stream.log(_body_path(root, model, body, kind), shapes, static=True)


def log_motion(
    stream: rr.RecordingStream,
    root: str,
    model: mujoco.MjModel,
    bodies: Sequence[int],
    qpos: ArrayLike,
    timeline: str,
    times: ArrayLike,
) -> None:
    """Log the poses of `bodies` at each of the times [N], from MuJoCo's qpos [N, nq]."""
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
    """Log the static poses of `bodies`, from one qpos [nq]."""
    positions, rotations = body_poses(model, np.atleast_2d(np.asarray(qpos, dtype=np.float64)))
    for body in bodies:
        pose = rr.Transform3D(
            translation=positions[0, body], quaternion=rr.Quaternion(xyzw=rotations[0, body])
        )
        stream.log(_body_path(root, model, body), pose, static=True)


def body_poses(model: mujoco.MjModel, qpos: Doubles) -> tuple[Floats, Floats]:
    """Positions [N, B, 3] in m and rotations [N, B, 4] of all B bodies, from qpos [N, nq].

    Both are in the world's frame; a rotation is a quaternion (x, y, z, w).

    Raises:
        ValueError: the length of qpos is not that of the model.
    """
    if qpos.shape[-1] != model.nq:
        raise ValueError(f"qpos: got {qpos.shape[-1]} numbers; the model has {model.nq}")
    data = mujoco.MjData(model)
    positions = np.empty((len(qpos), model.nbody, 3), dtype=np.float32)
    rotations = np.empty((len(qpos), model.nbody, 4), dtype=np.float32)
    for row, configuration in enumerate(qpos):
        data.qpos[:] = configuration
        mujoco.mj_kinematics(model, data)
        positions[row] = data.xpos
        rotations[row] = xyzw(data.xquat)
    return positions, rotations


def finite_steps(states: Floats) -> int:
    """The number of states of [T, D] before the first that is not finite; at least one."""
    undefined = ~np.isfinite(states).all(axis=-1)
    return max(1, int(undefined.argmax())) if undefined.any() else len(states)


def xyzw(quaternions: Array) -> Array:
    """MuJoCo's quaternions [..., 4] (w first) as Rerun's (w last)."""
    return np.roll(quaternions, -1, axis=-1)


def _body_path(root: str, model: mujoco.MjModel, body: int, *below: str) -> str:
    """The entity of a body, or an entity below it."""
    return entity_below(root, model.body(body).name or f"body_{body}", *below)


def _colour(model: mujoco.MjModel, geom: int) -> Pixels:
    """The colour of a geom or of its material, multiplied by the mean colour of its texture."""
    material = int(model.geom_matid[geom])
    if material < 0:
        rgba = model.geom_rgba[geom].copy()
    else:
        rgba = model.mat_rgba[material].copy()
        texture = int(model.mat_texid[material, mujoco.mjtTextureRole.mjTEXROLE_RGB])
        if texture >= 0:
            channels = int(model.tex_nchannel[texture])
            pixels = int(model.tex_height[texture]) * int(model.tex_width[texture])
            start = int(model.tex_adr[texture])
            data = model.tex_data[start : start + pixels * channels].reshape(pixels, channels)
            rgba[:3] *= data[:, :3].mean(axis=0) / 255
    return np.asarray(np.clip(rgba, 0, 1) * 255, dtype=np.uint8)


def _shapes(model: mujoco.MjModel, kind: str, geoms: list[int]) -> rr.AsComponents:
    """The geoms of one kind and one body, in the frame of the body."""
    size, centres = model.geom_size[geoms], model.geom_pos[geoms]
    style: dict[str, Any] = {
        "colors": [_colour(model, geom) for geom in geoms],
        "quaternions": xyzw(model.geom_quat[geoms]),
        "fill_mode": rr.components.FillMode.Solid,
    }
    if kind == "boxes":
        return rr.Boxes3D(half_sizes=size, centers=centres, **style)
    if kind == "planes":
        # Size 0 is an infinite plane in MuJoCo. A box larger than the model replaces it.
        half = np.where(size > 0, size, 3 * model.stat.extent)
        half[:, 2] = _THICKNESS
        return rr.Boxes3D(half_sizes=half, centers=centres, **style)
    if kind == "ellipsoids":
        spheres = model.geom_type[geoms] == mujoco.mjtGeom.mjGEOM_SPHERE
        half = np.where(spheres[:, None], size[:, :1], size)
        return rr.Ellipsoids3D(half_sizes=half, centers=centres, **style)
    lengths, radii = 2 * size[:, 1], size[:, 0]
    if kind == "cylinders":
        return rr.Cylinders3D(lengths=lengths, radii=radii, centers=centres, **style)
    starts = [
        capsule_start(centre, model.geom_quat[geom], float(half))
        for geom, centre, half in zip(geoms, centres, size[:, 1], strict=True)
    ]
    return rr.Capsules3D(lengths=lengths, radii=radii, translations=starts, **style)


def capsule_start(centre: Doubles, quaternion: Doubles, half_length: float) -> Doubles:
    """The start [3] of a capsule, from which Rerun measures it. MuJoCo measures from the centre."""
    offset = np.zeros(3)
    mujoco.mju_rotVecQuat(offset, np.array([0.0, 0.0, -half_length]), quaternion)
    return np.asarray(centre + offset)


def _mesh(model: mujoco.MjModel, geom: int) -> rr.Mesh3D:
    """The mesh of a geom, in the frame of its body."""
    mesh = int(model.geom_dataid[geom])
    vertices = model.mesh_vert[model.mesh_vertadr[mesh] :][: model.mesh_vertnum[mesh]]
    faces = model.mesh_face[model.mesh_faceadr[mesh] :][: model.mesh_facenum[mesh]]
    rotation = np.empty(9)
    mujoco.mju_quat2Mat(rotation, model.geom_quat[geom])
    positions = vertices @ rotation.reshape(3, 3).T + model.geom_pos[geom]
    albedo = rr.AlbedoFactor(_colour(model, geom))
    return rr.Mesh3D(vertex_positions=positions, triangle_indices=faces, albedo_factor=albedo)
