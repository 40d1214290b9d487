"""Fans: observed and forecast paths of one scenario in the 3D scene, its target, and the eye.

The viewer does not blend lines with what lies behind them (of a transparent colour it shows a
darker one), so all lines are opaque: what is many is thin, what matters is thick or has a label.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from study.common.arrays import Doubles, Floats, Integers, Pixels
from study.plotting.palette import FORECAST, OBSERVED, RUN, TARGET, Colour, series
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
# Paths are flat if they are less than so many extents high. The eye is so many extents above flat
# ones (more: something may tower over them), and so many beside others.
_FLAT = 0.05
_ABOVE = 3.0
_ASIDE = 1.9

Points = Floats


def log_fan(
    stream: rr.RecordingStream,
    entity: str,
    paths: Points,
    colours: Colour | Sequence[Colour],
    width: float = 1.0,
) -> None:
    """Paths [K, T, 3] as lines, for the whole horizon, in one colour or in K.

    Each ends where it is first not finite.
    """
    each = _table(colours)
    drawn = paths[:, _thin(paths.shape[1])]
    strips = [(path, k) for k, path in enumerate(map(_until_lost, drawn)) if len(path) > 1]
    lines = rr.LineStrips3D(
        [path for path, _ in strips],
        colors=[each[k % len(each)] for _, k in strips],
        radii=rr.Radius.ui_points(width),
    )
    stream.log(entity, lines, static=True)


def log_cloud(
    stream: rr.RecordingStream,
    entity: str,
    paths: Points,
    colours: Colour | Sequence[Colour],
    size: float = 4.0,
) -> None:
    """Where the first few of the paths [K, T, 3] are, as dots that move with the timeline."""
    chosen = _thin(paths.shape[1])
    paths = paths[:_DOTS, chosen]
    count, steps, _ = paths.shape
    points = np.where(np.isfinite(paths), paths, np.nan).transpose(1, 0, 2).reshape(-1, 3)
    times = [time_column(TIMELINE, chosen + 1)]
    columns = rr.Points3D.columns(positions=points).partition(np.full(steps, count))
    look = rr.Points3D.from_fields(colors=_table(colours)[:count], radii=rr.Radius.ui_points(size))
    stream.log(entity, look, static=True)
    stream.send_columns(entity, times, columns)


def log_target(stream: rr.RecordingStream, entity: str, target: Points, radius: float) -> None:
    """The target [3], and the sphere within which the goal succeeds.

    The target stands on a pole, at whose foot is its name: the viewer draws names above all else,
    so that a sphere of 5 m is found among paths of 100 m.
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


def log_paths(
    stream: rr.RecordingStream,
    root: str,
    simulator: "Simulator",
    goal: Floats,
    observed: Floats,
    forecast: Floats,
    member: Integers | None = None,
    members: Floats | None = None,
) -> None:
    """All that is drawn of one scenario besides the scene.

    States [K, T, D] observed and forecast; with an ensemble `member` [K], the member behind each
    forecast, and `members` [M, T, D], the members' own: thick, with its samples thin in its colour
    (of member m, where there are more, the colour of m mod M).
    """
    seen = simulator.position(observed).astype(np.float32)
    target = np.asarray(simulator.target(goal), dtype=np.float32).reshape(3)
    promised = within_reach(simulator.position(forecast), seen)
    colours: Colour | list[Colour] = FORECAST
    if member is not None:
        shown = len(members) if members is not None else member.max() + 1
        colours = [series(int(m) % shown) for m in member]
    log_target(stream, f"{root}/target", target, simulator.radius)
    log_fan(stream, f"{root}/observed", seen, OBSERVED, 0.5)
    log_fan(stream, f"{root}/forecast", promised, colours, 0.5)
    if members is not None:
        own = within_reach(simulator.position(members), seen)
        thick = [series(place) for place in range(len(own))]
        log_fan(stream, f"{root}/members", own, thick, 2.5)
    log_cloud(stream, f"{root}/observed_now", seen, OBSERVED)
    log_cloud(stream, f"{root}/forecast_now", promised, colours)
    log_cloud(stream, f"{root}/this_run", seen[:1], RUN, 9.0)


def within_reach(paths: Points, observed: Points) -> Points:
    """Paths [K, T, 3] with NaN where they are absurdly far from the observed ones [K, T, 3]."""
    centre, extent = _extent(observed)
    with np.errstate(invalid="ignore", over="ignore"):
        far = np.abs(paths.astype(np.float64) - centre).max(axis=-1) <= _REACH * extent
    return np.where(far[..., None], paths, np.nan).astype(np.float32)


def eye(observed: Points, target: Points) -> rrb.EyeControls3D:
    """Look at the observed paths [K, T, 3] and the target [3].

    What stays on a table is looked at from above; what flies from the side, across its way, so
    that its height is seen.
    """
    everything = np.concatenate([observed.reshape(-1, 3), np.asarray(target).reshape(1, 3)])
    centre, extent = _extent(everything)
    everything = everything[np.isfinite(everything).all(axis=1)] - centre  # the target is
    if np.ptp(everything[:, 2]) < _FLAT * extent:
        direction = np.array([0.0, -0.4, 1.0]) * _ABOVE
    else:
        # The horizontal direction in which the paths are longest, and across it.
        along = np.linalg.svd(everything[:, :2].astype(np.float64), full_matrices=False)[2][0]
        across = np.array([along[1], -along[0]])
        across *= -1.0 if across[1] > 0 else 1.0  # from the south, as a map is read
        direction = np.array([*across, 0.45]) * _ASIDE
    position = centre + extent * direction
    return rrb.EyeControls3D(
        kind=rrb.Eye3DKind.Orbital, position=position, look_target=centre, eye_up=(0, 0, 1)
    )


def _extent(points: Points) -> tuple[Doubles, float]:
    """The centre [3] of some points [..., 3] and half the longest side of the box around them."""
    flat = points.reshape(-1, 3).astype(np.float64)
    flat = flat[np.isfinite(flat).all(axis=1)]
    if not len(flat):
        return np.zeros(3), 1.0
    low, high = flat.min(axis=0), flat.max(axis=0)
    return (low + high) / 2, max(float((high - low).max()) / 2, 1e-3)


def _thin(steps: int) -> Integers:
    """At most `_POINTS` of the steps, evenly, the first and the last among them."""
    return np.unique(np.linspace(0, steps - 1, min(steps, _POINTS)).round().astype(np.int64))


def _table(colours: Colour | Sequence[Colour]) -> Pixels:
    """One colour, or several, as rows [C, 4]."""
    return np.reshape(np.asarray(colours, dtype=np.uint8), (-1, 4))


def _until_lost(path: Points) -> Points:
    lost = ~np.isfinite(path).all(axis=-1)
    return path[: int(lost.argmax())] if lost.any() else path
