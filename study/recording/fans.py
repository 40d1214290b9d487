"""Fans: observed and forecast paths of one scenario in the 3D scene, its target, and the eye."""

from typing import TYPE_CHECKING

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from study.recording.palette import FORECAST, NOW, OBSERVED, TARGET, Colour, faint, series
from study.recording.streams import time_column

if TYPE_CHECKING:
    from study.envs.simulator import Simulator

TIMELINE = "horizon"
# A forecast's path is drawn while it stays within so many extents of what was observed.
_REACH = 3.0
_CIRCLE = 64
# A path is drawn by so many points at most, and so many runs have a moving dot.
_POINTS = 40
_DOTS = 10

Points = NDArray[np.float32]


def log_fan(
    stream: rr.RecordingStream, entity: str, paths: Points, colour: Colour, width: float = 1.0
) -> None:
    """Paths [K, T, 3] as lines, for the whole horizon. Each ends where it is first not finite."""
    drawn = paths[:, _thin(paths.shape[1])]
    strips = [path for path in map(_until_lost, drawn) if len(path) > 1]
    lines = rr.LineStrips3D(strips, colors=[colour], radii=rr.Radius.ui_points(width))
    stream.log(entity, lines, static=True)


def log_cloud(
    stream: rr.RecordingStream, entity: str, paths: Points, colour: Colour, size: float = 3.0
) -> None:
    """Where the first few of the paths [K, T, 3] are, as dots that move with the timeline."""
    chosen = _thin(paths.shape[1])
    paths = paths[:_DOTS, chosen]
    count, steps, _ = paths.shape
    points = np.where(np.isfinite(paths), paths, np.nan).transpose(1, 0, 2).reshape(-1, 3)
    times = [time_column(TIMELINE, chosen + 1)]
    columns = rr.Points3D.columns(positions=points).partition(np.full(steps, count))
    look = rr.Points3D.from_fields(colors=[colour], radii=rr.Radius.ui_points(size))
    stream.log(entity, look, static=True)
    stream.send_columns(entity, times, columns)


def log_members(stream: rr.RecordingStream, entity: str, paths: Points) -> None:
    """The ensemble's members [M, T, 3], each in a colour of its own."""
    strips, colours = [], []
    for member, path in enumerate(map(_until_lost, paths)):
        if len(path) > 1:
            strips.append(path)
            colours.append(series(member))
    lines = rr.LineStrips3D(strips, colors=colours, radii=rr.Radius.ui_points(2.0))
    stream.log(entity, lines, static=True)


def log_target(stream: rr.RecordingStream, entity: str, target: Points, radius: float) -> None:
    """The target [3]: a dot, and the sphere within which the task succeeds, with its equator."""
    dot = rr.Points3D([target], colors=[TARGET], radii=rr.Radius.ui_points(5.0))
    stream.log(f"{entity}/centre", dot, static=True)
    sphere = rr.Ellipsoids3D(
        centers=[target],
        half_sizes=[[radius] * 3],
        colors=[faint(TARGET, 40)],
        fill_mode=rr.components.FillMode.TransparentFillMajorWireframe,
    )
    stream.log(f"{entity}/sphere", sphere, static=True)
    angle = np.linspace(0.0, 2 * np.pi, _CIRCLE)
    circle = target + radius * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=-1)
    ring = rr.LineStrips3D([circle], colors=[TARGET], radii=rr.Radius.ui_points(2.0))
    stream.log(f"{entity}/circle", ring, static=True)


def log_paths(
    stream: rr.RecordingStream,
    root: str,
    simulator: "Simulator",
    task: NDArray[np.float32],
    observed: NDArray[np.float32],
    forecast: NDArray[np.float32],
    members: NDArray[np.float32] | None,
) -> None:
    """All that is drawn of one scenario besides the scene; states [K, T, D] and [M, T, D]."""
    seen = simulator.position(observed).astype(np.float32)
    target = np.asarray(simulator.target(task), dtype=np.float32).reshape(3)
    log_target(stream, f"{root}/target", target, simulator.radius)
    log_fan(stream, f"{root}/observed", seen, faint(OBSERVED, 110))
    promised = within_reach(simulator.position(forecast), seen)
    log_fan(stream, f"{root}/forecast", promised, faint(FORECAST, 110))
    log_cloud(stream, f"{root}/observed_now", seen, OBSERVED)
    log_cloud(stream, f"{root}/forecast_now", promised, FORECAST)
    log_cloud(stream, f"{root}/this_rollout", seen[:1], NOW, 6.0)
    if members is not None:
        log_members(stream, f"{root}/members", within_reach(simulator.position(members), seen))


def within_reach(paths: Points, observed: Points) -> Points:
    """Paths [K, T, 3] with NaN where they are absurdly far from the observed ones [K, T, 3]."""
    centre, extent = _extent(observed)
    with np.errstate(invalid="ignore", over="ignore"):
        far = np.abs(paths.astype(np.float64) - centre).max(axis=-1) <= _REACH * extent
    return np.where(far[..., None], paths, np.nan).astype(np.float32)


def eye(observed: Points, target: Points) -> rrb.EyeControls3D:
    """Look at the observed paths [K, T, 3] and the target [3] from the south, and from above."""
    everything = np.concatenate([observed.reshape(-1, 3), np.asarray(target).reshape(1, 3)])
    centre, extent = _extent(everything)
    position = centre + 2.0 * extent * np.array([-0.25, -0.75, 1.0])
    return rrb.EyeControls3D(
        kind=rrb.Eye3DKind.Orbital, position=position, look_target=centre, eye_up=(0, 0, 1)
    )


def _extent(points: Points) -> tuple[NDArray[np.float64], float]:
    """The centre [3] of some points [..., 3] and half the longest side of the box around them."""
    flat = points.reshape(-1, 3).astype(np.float64)
    flat = flat[np.isfinite(flat).all(axis=1)]
    if not len(flat):
        return np.zeros(3), 1.0
    low, high = flat.min(axis=0), flat.max(axis=0)
    return (low + high) / 2, max(float((high - low).max()) / 2, 1e-3)


def _thin(steps: int) -> NDArray[np.int64]:
    """At most `_POINTS` of the steps, evenly, the first and the last among them."""
    return np.unique(np.linspace(0, steps - 1, min(steps, _POINTS)).round().astype(np.int64))


def _until_lost(path: Points) -> Points:
    lost = ~np.isfinite(path).all(axis=-1)
    return path[: int(lost.argmax())] if lost.any() else path
