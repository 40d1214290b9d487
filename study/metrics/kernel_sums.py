"""Means of a Gaussian kernel over all pairs of two scalar samples, in linear time.

On a bounded interval a short Fourier series approximates a Gaussian. Poisson's summation formula
gives, for any period P and Δ = 2π / P,

    Σ_n exp(-(u + nP)²) = Σ_{j ≥ 0} w_j cos(jΔu),   w_0 = Δ / 2√π,   w_j = Δ / √π · exp(-(jΔ)² / 4)

On the left, the terms n ≠ 0 are negligible if |u| is a few units below P. On the right, the terms
beyond the first few j are negligible. With the empirical characteristic functions φ_x(ω) =
mean_i exp(iωx_i) and φ_y,

    mean_ij exp(-(x_i - y_j)²) = Σ_j w_j Re φ_x(jΔ) φ_y(jΔ)*

This takes K + L exponentials and about ten multiplications each, instead of K·L exponentials. The
idea is that of Kunis, Potts and Steidl, "Fast Gauss transforms with complex parameters using
NFFTs", Journal of Numerical Mathematics 14, 2006. So few frequencies need no FFT.

Values that are too far apart for one short series are divided into bins, no narrower than the
kernel's reach. A value then has kernels above `ERROR` only with its own bin and the two next to it.

All numbers are float64 and finite; others are refused. `study.metrics.mmd` has the rule for
forecasts that are not finite. The code is exact to `ERROR`. It runs in one thread, or on the device
of `study.metrics.device`.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from study.common.arrays import Doubles, Integers
from study.metrics.device import at_once, score_device

Complexes = NDArray[np.complex128]

ERROR = 1e-9
"""Largest error of a kernel: from its images, its high frequencies and its tail beyond `REACH`."""

REACH = 4.6
"""exp(-u²) is below `ERROR` for u above this."""

HIGHEST = 8.8
"""Frequencies above this one contribute less than `ERROR` to exp(-u²): erfc(ω / 2)."""

WIDE = 16
"""Span, in units of the reach, above which bins are faster than one series."""

FARTHEST = 1e16
"""Largest span for which bin numbers are exact."""

BLOCK = 2**15
"""Numbers that are processed at once: so many fit into the processor's cache."""


@dataclass(frozen=True)
class Gaps:
    """Means of 1 - k over all pairs, each [F, C] for F kernels and C columns.

    The pairs i = j are included and contribute 0. The mean over pairs i ≠ j of K numbers is
    therefore K / (K - 1) times as large. Numbers that are all equal give exactly 0.
    """

    among_x: Doubles
    among_y: Doubles
    across: Doubles


def gaps(x: Doubles, y: Doubles, factors: Sequence[float] = (1.0,)) -> Gaps:
    """Mean of 1 - exp(-(u / f)²) over the pairs of each column, where u is their distance.

    Args:
        x: [K, C], finite.
        y: [L, C], finite.
        factors: F kernel widths f. One call for all takes less time than one call each.

    Raises:
        ValueError: numbers that are not finite, or farther apart than `FARTHEST`.
    """
    low = np.minimum(x.min(0), y.min(0))
    span = np.maximum(x.max(0), y.max(0)) - low
    if not (span <= FARTHEST).all():
        raise ValueError(f"numbers are not finite, or too far apart (more than {FARTHEST:g})")
    # Columns of one block share a grid, so they should need about as many frequencies.
    order = np.argsort(span, kind="stable")
    wide = np.searchsorted(span[order], WIDE * REACH * max(factors))
    size = max(1, at_once(BLOCK) // max(len(x), len(y)))
    means = np.empty((3, len(factors), x.shape[1]))
    for columns in _blocks(order[:wide], size):
        middle = low[columns] + span[columns] / 2
        grid = _Grid.of(span[columns[-1]], factors)
        means[:, :, columns] = _short(_pick(x, columns, middle), _pick(y, columns, middle), grid)
    for columns in _blocks(order[wide:], size):
        x_part, y_part = (_pick(values, columns, low[columns]) for values in (x, y))
        means[:, :, columns] = _binned(x_part, y_part, factors)
    return Gaps(*means)


def _pick(numbers: Doubles, columns: Integers, origin: Doubles) -> Doubles:
    # `take` gives contiguous rows; an index does not.
    return numbers.take(columns, axis=1) - origin


def _blocks(order: Integers, size: int) -> Iterator[Integers]:
    return (order[start : start + size] for start in range(0, len(order), size))


@dataclass(frozen=True)
class _Grid:
    """The frequencies 0, Δ, 2Δ … for kernels on numbers of a known span."""

    step: float
    weights: Doubles
    """[F, J]; each row sums to 1."""

    @staticmethod
    def of(span: float, factors: Sequence[float]) -> "_Grid":
        step = 2 * np.pi / (span + REACH * max(factors))
        frequencies = step * np.arange(int(HIGHEST / min(factors) / step) + 2)
        weights = np.exp(-((np.outer(factors, frequencies) / 2) ** 2))
        weights[:, 0] /= 2
        return _Grid(step, weights / weights.sum(1, keepdims=True))

    def powers(self, numbers: Doubles) -> Iterator[Complexes]:
        """exp(i jΔ numbers) for each j. All share one buffer: use each before the next."""
        turn = np.empty(numbers.shape, np.complex128)
        angles = numbers * self.step
        np.cos(angles, out=turn.real)
        np.sin(angles, out=turn.imag)
        power = np.ones_like(turn)
        yield power
        for _ in range(1, self.weights.shape[1]):
            yield np.multiply(power, turn, out=power)


def _short(x: Doubles, y: Doubles, grid: _Grid) -> Doubles:
    """Gaps [3, F, C] of columns that fit into one period."""
    phi, psi = (_mean_powers(values, grid) for values in (x, y))
    products = np.stack([_product(phi, phi), _product(psi, psi), _product(phi, psi)])
    return np.einsum("fj,pjc->pfc", grid.weights, 1 - products)


def _mean_powers(numbers: Doubles, grid: _Grid) -> Complexes:
    """The empirical characteristic function [J, C] at the grid's frequencies."""
    device = score_device()
    if device is not None:
        return _mean_powers_on(device, numbers, grid)
    sums = [np.add.reduce(power, 0) for power in grid.powers(numbers)]
    return np.asarray(np.stack(sums) / len(numbers), np.complex128)


def _mean_powers_on(device: torch.device, numbers: Doubles, grid: _Grid) -> Complexes:
    """See `_mean_powers`: on a GPU, many frequencies at once."""
    values = torch.from_numpy(numbers).to(device)
    frequencies = grid.step * torch.arange(grid.weights.shape[1], device=device, dtype=values.dtype)
    means = []
    for some in frequencies.split(max(1, at_once(BLOCK) // max(1, values.numel()))):
        angles = some[:, None, None] * values
        means.append(torch.complex(angles.cos().mean(1), angles.sin().mean(1)))
    return np.asarray(torch.cat(means).cpu().numpy(), np.complex128)


def _product(first: Complexes, second: Complexes) -> Doubles:
    """Re(first · second*)."""
    return np.asarray(first.real * second.real + first.imag * second.imag)


def _binned(x: Doubles, y: Doubles, factors: Sequence[float]) -> Doubles:
    """Gaps [3, F, C] of columns of any span. No number is negative."""
    width = REACH * max(factors)
    grid = _Grid.of(2 * width, factors)  # the span of two neighbouring bins
    columns = x.shape[1]
    numbers = np.concatenate([x, y])
    bins = np.floor(numbers / width)
    # The numbers of x in a bin have one label, those of y the next. The bin to the right has the
    # two labels after these. Labels of different columns are further apart.
    stride = 2 * int(bins.max()) + 4
    labels = 2 * bins.astype(np.int64) + stride * np.arange(columns)
    labels[len(x) :] += 1
    order = np.argsort(labels, axis=None, kind="stable")
    inside = (numbers - width * bins).ravel()[order]
    parts, starts = np.unique(labels.ravel()[order], return_index=True)
    share = 1 / np.array([len(x), len(y)])[parts % 2]
    first, second, right, times, group = _neighbours(parts, stride, columns)
    products = np.zeros((len(factors), len(first)))
    for j, (weights, power) in enumerate(zip(grid.weights.T, grid.powers(inside), strict=True)):
        sums = np.add.reduceat(power, starts) * share
        # Positions are relative to the start of a bin, so the next bin has another phase.
        phase = np.where(right, np.exp(1j * j * grid.step * width), 1)
        products += weights[:, None] * _product(sums[first], sums[second] * phase)
    totals = [np.bincount(group, times * row, 3 * columns).reshape(3, columns) for row in products]
    return np.asarray(1 - np.stack(totals, axis=1), np.float64)


def _neighbours(parts: Integers, stride: int, columns: int) -> tuple[Integers, ...]:
    """Pairs of parts of bins that are within reach of each other; see `_binned` for their labels.

    For each pair: the indices of both parts, whether the second is in the bin to the right, the
    multiplicity of the pair, and its kind (x, y or across) and column as one number.
    """
    pairs = []
    for offset in range(4):
        index = np.searchsorted(parts, parts + offset)
        present = parts[np.minimum(index, len(parts) - 1)] == parts + offset
        # The label three after that of y belongs to x, two bins away.
        first = np.flatnonzero(present & ~((parts % 2 == 1) & (offset == 3)))
        side = parts[first] % 2
        right = (side + offset) // 2
        kind = np.full_like(side, 2) if offset % 2 else side
        times = np.full_like(side, 2 if offset == 2 else 1)
        pairs.append((first, index[first], right, times, kind * columns + parts[first] // stride))
    return tuple(np.concatenate(column) for column in zip(*pairs, strict=True))
