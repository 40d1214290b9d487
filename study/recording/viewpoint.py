"""The viewpoint of the viewer in a 3D scene."""

import numpy as np
import rerun.blueprint as rrb

from study.common.arrays import Doubles, Floats

# Paths are flat if their height is below this share of their extent.
_FLAT = 0.05
# Distances of the eye, in extents. Flat paths need more, since bodies may be higher than the paths.
_ABOVE = 3.0
_ASIDE = 1.9


def eye(observed: Floats, target: Floats) -> rrb.EyeControls3D:
    """An eye with the observed paths [K, T, 3] and the target [3], in m, in view.

    The eye is above flat paths, such as those on a table. It is on the side of a flight, at a right
    angle to its direction, so that the height is visible.
    """
    points = np.concatenate([observed.reshape(-1, 3), np.asarray(target).reshape(1, 3)])
    centre, half = centre_and_extent(points)
    offsets = points[np.isfinite(points).all(axis=1)] - centre
    if np.ptp(offsets[:, 2]) < _FLAT * half:
        direction = np.array([0.0, -0.4, 1.0]) * _ABOVE
    else:
        # The horizontal direction in which the paths are longest, and the direction across.
        along = np.linalg.svd(offsets[:, :2].astype(np.float64), full_matrices=False)[2][0]
        across = np.array([along[1], -along[0]])
        across *= -1.0 if across[1] > 0 else 1.0  # from the south, so that east is on the right
        direction = np.array([*across, 0.45]) * _ASIDE
    return _orbit(centre + half * direction, centre)


def close_up(size: float) -> rrb.EyeControls3D:
    """An eye near a body at the origin that is `size` metres large."""
    return _orbit(2.5 * size * np.array([-0.5, -1.0, 0.6]), np.zeros(3))


def centre_and_extent(points: Floats) -> tuple[Doubles, float]:
    """The centre [3] of points [..., 3], and half of the longest side of the box around them.

    Points that are not finite are ignored.
    """
    flat = points.reshape(-1, 3).astype(np.float64)
    flat = flat[np.isfinite(flat).all(axis=1)]
    if not len(flat):
        return np.zeros(3), 1.0
    low, high = flat.min(axis=0), flat.max(axis=0)
    return (low + high) / 2, max(float((high - low).max()) / 2, 1e-3)


def _orbit(position: Doubles, centre: Doubles) -> rrb.EyeControls3D:
    return rrb.EyeControls3D(
        kind=rrb.Eye3DKind.Orbital, position=position, look_target=centre, eye_up=(0, 0, 1)
    )
