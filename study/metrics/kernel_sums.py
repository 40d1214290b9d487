"""Means of a Gaussian kernel over all pairs of two samples of numbers, in linear time.

On a bounded interval a Gaussian is a short Fourier series. With Poisson's summation formula, for
any period P and Δ = 2π / P,

    Σ_n exp(-(u + nP)²) = Σ_{j ≥ 0} w_j cos(jΔu),   w_0 = Δ / 2√π,   w_j = Δ / √π · exp(-(jΔ)² / 4)

On the left all but n = 0 vanish if |u| stays a few units below P; on the right all but the first
few j do. So, with the empirical characteristic functions φ_x(ω) = mean_i exp(iωx_i) and φ_y,

    mean_ij exp(-(x_i - y_j)²) = Σ_j w_j Re φ_x(jΔ) φ_y(jΔ)*

which costs K + L exponentials, and some ten multiplications each, instead of K·L exponentials
(the idea of Kunis, Potts and Steidl, "Fast Gauss transforms with complex parameters using NFFTs",
Journal of Numerical Mathematics 14, 2006; so few frequencies need no FFT). Where values are too
far apart for one short series, the line is cut into bins no narrower than the kernel's reach: a
value meets only its own bin and the two beside it, and those three share one period.

Everything is float64, in one thread, and exact to `ERROR`.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from study.common.arrays import Doubles, Integers

Complexes = NDArray[np.complex128]

ERROR = 1e-9
"""What is left out of a kernel: its images, its high frequencies, and its tail beyond its reach."""

REACH = 4.6
"""exp(-u²) is below `ERROR` from here on."""

HIGHEST = 8.8
"""Frequencies above this one hold less than `ERROR` of exp(-u²): erfc(ω / 2)."""

WIDE = 16
"""Span in reaches from which bins pay: a frequency costs them more, but they need fewer."""

FARTHEST = 1e16
"""Span that bins can number."""

BLOCK = 2**15
"""Numbers that are worked on at once: they stay in the cache."""


@dataclass(frozen=True)
class Gaps:
    """Means of 1 - k, each [F, C] for F kernels and C columns.

    Over all pairs, each number with itself included, which adds nothing: the mean over pairs i ≠ j
    of K numbers is K / (K - 1) times as much. Numbers that are all equal give exactly 0.
    """

    among_x: Doubles
    among_y: Doubles
    across: Doubles


def gaps(x: Doubles, y: Doubles, factors: Sequence[float] = (1.0,)) -> Gaps:
    """Mean of 1 - exp(-(u / f)²) over the pairs of each column, u their distance.

    Args:
        x: [K, C], finite.
        y: [L, C], finite.
        factors: F widths f of the kernel. Together they cost less than one by one.

    Raises:
        ValueError: numbers that are not finite, or farther apart than `FARTHEST`.
    """
    low = np.minimum(x.min(0), y.min(0))
    span = np.maximum(x.max(0), y.max(0)) - low
    if not (span <= FARTHEST).all():
        raise ValueError("kernels of numbers that are not finite, or too far apart")
    # Columns that need about as many frequencies are worked on together.
    order = np.argsort(span, kind="stable")
    wide = np.searchsorted(span[order], WIDE * REACH * max(factors))
    size = max(1, BLOCK // max(len(x), len(y)))
    found = np.empty((3, len(factors), x.shape[1]))
    for columns in _blocks(order[:wide], size):
        middle = low[columns] + span[columns] / 2
        grid = _Grid.of(span[columns[-1]], factors)
        found[:, :, columns] = _short(_pick(x, columns, middle), _pick(y, columns, middle), grid)
    for columns in _blocks(order[wide:], size):
        x_part, y_part = (_pick(z, columns, low[columns]) for z in (x, y))
        found[:, :, columns] = _binned(x_part, y_part, factors)
    return Gaps(*found)


def _pick(numbers: Doubles, columns: Integers, origin: Doubles) -> Doubles:
    # `take` keeps the rows contiguous, as an index would not.
    return numbers.take(columns, axis=1) - origin


def _blocks(order: Integers, size: int) -> Iterator[Integers]:
    return (order[start : start + size] for start in range(0, len(order), size))


@dataclass(frozen=True)
class _Grid:
    """The frequencies 0, Δ, 2Δ … that serve some kernels on numbers of a given span."""

    step: float
    weights: Doubles
    """[F, J], each row sums to 1."""

    @staticmethod
    def of(span: float, factors: Sequence[float]) -> "_Grid":
        step = 2 * np.pi / (span + REACH * max(factors))
        frequencies = step * np.arange(int(HIGHEST / min(factors) / step) + 2)
        weights = np.exp(-((np.outer(factors, frequencies) / 2) ** 2))
        weights[:, 0] /= 2
        return _Grid(step, weights / weights.sum(1, keepdims=True))

    def powers(self, numbers: Doubles) -> Iterator[Complexes]:
        """exp(i jΔ numbers) for each j. The same memory each time: use it before the next."""
        turn = np.empty(numbers.shape, np.complex128)
        angles = numbers * self.step
        np.cos(angles, out=turn.real)
        np.sin(angles, out=turn.imag)
        power = np.ones_like(turn)
        yield power
        for _ in range(1, self.weights.shape[1]):
            yield np.multiply(power, turn, out=power)


def _short(x: Doubles, y: Doubles, grid: _Grid) -> Doubles:
    """Gaps [3, F, C] of columns that one period holds."""
    phi, psi = (_mean_powers(z, grid) for z in (x, y))
    met = np.stack([_product(phi, phi), _product(psi, psi), _product(phi, psi)])
    return np.einsum("fj,pjc->pfc", grid.weights, 1 - met)


def _mean_powers(numbers: Doubles, grid: _Grid) -> Complexes:
    """The empirical characteristic function [J, C] at the grid's frequencies."""
    sums = [np.add.reduce(power, 0) for power in grid.powers(numbers)]
    return np.asarray(np.stack(sums) / len(numbers), np.complex128)


def _product(one: Complexes, other: Complexes) -> Doubles:
    """Re(one · other*)."""
    return np.asarray(one.real * other.real + one.imag * other.imag)


def _binned(x: Doubles, y: Doubles, factors: Sequence[float]) -> Doubles:
    """Gaps [3, F, C] of columns of any span; all numbers are from 0 on."""
    width = REACH * max(factors)
    grid = _Grid.of(2 * width, factors)  # what two bins side by side span
    columns = x.shape[1]
    numbers = np.concatenate([x, y])
    bins = np.floor(numbers / width)
    # A bin's numbers of x have a name, its numbers of y the next one, and the bin to the right
    # the two names after these; columns are far apart.
    stride = 2 * int(bins.max()) + 4
    names = 2 * bins.astype(np.int64) + stride * np.arange(columns)
    names[len(x) :] += 1
    order = np.argsort(names, axis=None, kind="stable")
    inside = (numbers - width * bins).ravel()[order]
    parts, starts = np.unique(names.ravel()[order], return_index=True)
    share = 1 / np.array([len(x), len(y)])[parts % 2]
    one, other, right, times, group = _meetings(parts, stride, columns)
    met = np.zeros((len(factors), len(one)))
    for j, (weights, power) in enumerate(zip(grid.weights.T, grid.powers(inside), strict=True)):
        sums = np.add.reduceat(power, starts) * share
        # Each bin counts from its own start, so the one to the right is a phase away.
        phase = np.where(right, np.exp(1j * j * grid.step * width), 1)
        met += weights[:, None] * _product(sums[one], sums[other] * phase)
    totals = [np.bincount(group, times * row, 3 * columns).reshape(3, columns) for row in met]
    return np.asarray(1 - np.stack(totals, axis=1), np.float64)


def _meetings(parts: Integers, stride: int, columns: int) -> tuple[Integers, ...]:
    """Which parts of bins are within reach of each other; see `_binned` for their names.

    For each meeting: the two parts, whether the second is in the bin to the right, how often the
    meeting counts, and what it counts for: kind (x, y, across) and column, as one number.
    """
    found = []
    for offset in range(4):
        place = np.searchsorted(parts, parts + offset)
        there = parts[np.minimum(place, len(parts) - 1)] == parts + offset
        # Three names after y's is x's two bins away.
        one = np.flatnonzero(there & ~((parts % 2 == 1) & (offset == 3)))
        side = parts[one] % 2
        right = (side + offset) // 2
        kind = np.full_like(side, 2) if offset % 2 else side
        times = np.full_like(side, 2 if offset == 2 else 1)
        found.append((one, place[one], right, times, kind * columns + parts[one] // stride))
    return tuple(np.concatenate(each) for each in zip(*found, strict=True))
