"""Observed and forecast paths of one scenario in the 3D scene, and its target.

The viewer does not blend transparent lines with their background, but darkens them. So all lines
are opaque. Samples are thin lines, and the forecasts of ensemble members are thick lines.
"""

from collections.abc import Sequence

import numpy as np
import rerun as rr

from study.common.arrays import Floats, Integers, Pixels
from study.envs.simulator import Simulator
from study.plotting.palette import FORECAST, OBSERVED, REPLAYED, TARGET, Colour, series
from study.recording.streams import time_column
from study.recording.viewpoint import centre_and_extent

TIMELINE = "horizon"
# A forecast path is shown within this many extents around the observed paths.
_REACH = 3.0
_CIRCLE = 64
# Largest number of points of a path, and of paths with a moving dot.
_POINTS = 40
_DOTS = 10


def log_paths(
    stream: rr.RecordingStream,
    entity: str,
    paths: Floats,
    colours: Colour | Sequence[Colour],
    width: float = 1.0,
) -> None:
    """Log paths [K, T, 3] in m as static lines, in one colour or in K colours.

    A path ends before its first point that is not finite.
    """
    table = _colour_table(colours)
    thinned = paths[:, _thinned_steps(paths.shape[1])]
    strips = [(path, k) for k, path in enumerate(map(_finite_part, thinned)) if len(path) > 1]
    lines = rr.LineStrips3D(
        [path for path, _ in strips],
        colors=[table[k % len(table)] for _, k in strips],
        radii=rr.Radius.ui_points(width),
    )
    stream.log(entity, lines, static=True)


def log_moving_dots(
    stream: rr.RecordingStream,
    entity: str,
    paths: Floats,
    colours: Colour | Sequence[Colour],
    size: float = 4.0,
) -> None:
    """Log the first `_DOTS` paths of [K, T, 3] in m as dots that move along the timeline."""
    steps = _thinned_steps(paths.shape[1])
    paths = paths[:_DOTS, steps]
    count, length, _ = paths.shape
    points = np.where(np.isfinite(paths), paths, np.nan).transpose(1, 0, 2).reshape(-1, 3)
    times = [time_column(TIMELINE, steps + 1)]
    columns = rr.Points3D.columns(positions=points).partition(np.full(length, count))
    style = rr.Points3D.from_fields(
        colors=_colour_table(colours)[:count], radii=rr.Radius.ui_points(size)
    )
    stream.log(entity, style, static=True)
    stream.send_columns(entity, times, columns)


def log_target(stream: rr.RecordingStream, entity: str, target: Floats, radius: float) -> None:
    """Log the target [3] in m, and the sphere of `radius` m in which the goal is reached.

    A label at the foot of a pole below the target helps to find a small sphere among long paths.
    The label is not at the target, since the viewer draws labels in front of everything else.
    """
    foot = target * np.array([1.0, 1.0, 0.0], dtype=target.dtype)
    dot = rr.Points3D([target], colors=[TARGET], radii=rr.Radius.ui_points(6.0))
    stream.log(f"{entity}/centre", dot, static=True)
    name = rr.Points3D(
        [foot],
        colors=[TARGET],
        radii=rr.Radius.ui_points(1.0),
        labels=["target"],
        show_labels=True,
    )
    stream.log(f"{entity}/name", name, static=True)
    sphere = rr.Ellipsoids3D(
        centers=[target],
        half_sizes=[[radius] * 3],
        colors=[TARGET],
        fill_mode=rr.components.FillMode.TransparentFillMajorWireframe,
        line_radii=rr.Radius.ui_points(1.0),
    )
    stream.log(f"{entity}/sphere", sphere, static=True)
    angle = np.linspace(0.0, 2 * np.pi, _CIRCLE)
    circle = target + radius * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=-1)
    lines = rr.LineStrips3D(
        [circle, np.stack([target, foot])], colors=[TARGET], radii=rr.Radius.ui_points([2.0, 1.0])
    )
    stream.log(f"{entity}/lines", lines, static=True)


def log_scenario(
    stream: rr.RecordingStream,
    root: str,
    simulator: Simulator,
    goal: Floats,
    observed: Floats,
    forecast: Floats,
    member: Integers | None = None,
    members: Floats | None = None,
) -> None:
    """Log the target of one scenario, and its observed and forecast paths.

    With an ensemble, a sample has the colour of its member. The forecast of a member without noise
    is a thick line of the same colour.

    Args:
        stream: the recording.
        root: the parent of all entities of the scenario.
        simulator: computes the position and the target.
        goal: [G] in SI units.
        observed: [K, T, D], observed states in SI units.
        forecast: [K, T, D], forecast states in SI units.
        member: see `study.recording.examples.Example`.
        members: see `study.recording.examples.Example`.
    """
    observed_paths = simulator.position(observed).astype(np.float32)
    forecast_paths = simulator.position(forecast).astype(np.float32)
    near = observed_paths if len(observed_paths) else forecast_paths
    forecast_paths = within_reach(forecast_paths, near)
    target = np.asarray(simulator.target(goal), dtype=np.float32).reshape(3)
    colours: Colour | list[Colour] = FORECAST
    if member is not None:
        count = len(members) if members is not None else member.max() + 1
        colours = [series(int(m) % count) for m in member]
    if simulator.has_target:
        log_target(stream, f"{root}/target", target, simulator.radius)
    log_paths(stream, f"{root}/observed", observed_paths, OBSERVED, 0.5)
    log_paths(stream, f"{root}/forecast", forecast_paths, colours, 0.5)
    if members is not None:
        member_paths = within_reach(simulator.position(members), near)
        member_colours = [series(m) for m in range(len(members))]
        log_paths(stream, f"{root}/members", member_paths, member_colours, 2.5)
    log_moving_dots(stream, f"{root}/forecast_dots", forecast_paths, colours)
    if len(observed_paths):
        log_moving_dots(stream, f"{root}/observed_dots", observed_paths, OBSERVED)
        log_moving_dots(stream, f"{root}/replayed_dot", observed_paths[:1], REPLAYED, 9.0)


def within_reach(paths: Floats, observed: Floats) -> Floats:
    """Paths [K, T, 3] with NaN for each point that is far from all observed points [K, T, 3]."""
    centre, half = centre_and_extent(observed)
    with np.errstate(invalid="ignore", over="ignore"):
        near = np.abs(paths.astype(np.float64) - centre).max(axis=-1) <= _REACH * half
    return np.where(near[..., None], paths, np.nan).astype(np.float32)


def _finite_part(path: Floats) -> Floats:
    """The points of a path [T, 3] before the first that is not finite."""
    undefined = ~np.isfinite(path).all(axis=-1)
    return path[: int(undefined.argmax())] if undefined.any() else path


def _thinned_steps(steps: int) -> Integers:
    """At most `_POINTS` of the steps, evenly apart, with the first and the last."""
    return np.unique(np.linspace(0, steps - 1, min(steps, _POINTS)).round().astype(np.int64))


def _colour_table(colours: Colour | Sequence[Colour]) -> Pixels:
    """One colour or several as [N, 4]."""
    return np.atleast_2d(np.asarray(colours, dtype=np.uint8))
