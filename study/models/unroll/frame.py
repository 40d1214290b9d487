"""The canonical frame of a state: its first axis points from one point of the state to another.

A law that has no preferred direction is the same in every frame that turns with the state. So a
network that works in such a frame is equivariant to turns without having to learn it, up to the
bounds of the states (canonicalization: Kaba et al., ICML 2023, arXiv:2211.06489).
"""

from torch import Tensor

SMALLEST_DISTANCE = 1e-3
"""In SI units. Below it cos φ and sin φ are smaller, so that gradients stay finite."""


def direction(state: Tensor, columns: Tensor, scale: Tensor) -> tuple[Tensor, Tensor]:
    """cos φ and sin φ of the axis, both [..., 1].

    Args:
        state: [..., D] in normalised units. The means of the points are zero.
        columns: of the points (x, y) from which and to which the axis points, [2, 2].
        scale: of the two points, from normalised to SI units, [2].
    """
    # A CUDA graph cannot contain the numbers of the columns, only the tensor.
    points = scale[:, None] * state[..., columns]
    x, y = (points[..., 1, :] - points[..., 0, :]).unbind(-1)
    distance = (x.square() + y.square()).clamp(min=SMALLEST_DISTANCE**2).sqrt()
    return (x / distance)[..., None], (y / distance)[..., None]


def turn(values: Tensor, pairs: Tensor, cos: Tensor, sin: Tensor) -> Tensor:
    """Turn the pairs of `values` by φ; with −sin φ, by −φ.

    Args:
        values: [..., D], in units that are equal within each pair.
        pairs: columns (x, y), [Q, 2].
        cos, sin: of φ, [..., 1].

    Returns:
        [..., D]
    """
    first, second = pairs.unbind(1)
    x, y = values[..., first], values[..., second]
    turned = values.clone()
    turned[..., first] = cos * x - sin * y
    turned[..., second] = sin * x + cos * y
    return turned
