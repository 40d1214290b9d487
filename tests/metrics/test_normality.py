"""Tests of normality and of unimodality: statistics by definition, level and power."""

from collections.abc import Callable

import numpy as np
import pytest
from scipy.optimize import linprog

from study.common.arrays import Doubles
from study.metrics.dip import dip
from study.metrics.normality import (
    SIMULATIONS,
    count_rejections,
    henze_zirkler,
    not_gaussian,
    not_unimodal,
    principal,
)

SMALLEST = 1 / (1 + SIMULATIONS)


def generator(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def normal(*shape: int, seed: int = 0) -> Doubles:
    return generator(seed).standard_normal(shape)


def clusters(*shape: int, distance: float, seed: int = 0) -> Doubles:
    """Two Gaussian clusters of about equal size, apart along the first dimension."""
    points = normal(*shape, seed=seed)
    points[..., 0] += distance * (generator(seed + 1).random(shape[:-1]) < 0.5)
    return points


def banana(*shape: int) -> Doubles:
    x, noise = normal(*shape), normal(*shape, seed=1)
    return np.stack([x, x**2 + 0.3 * noise], axis=-1)


def disc(*shape: int) -> Doubles:
    angle, area = generator().random((2, *shape))
    return np.sqrt(area)[..., None] * np.stack(
        [np.cos(2 * np.pi * angle), np.sin(2 * np.pi * angle)], axis=-1
    )


def share(p_values: Doubles, level: float) -> float:
    result = count_rejections(p_values, level)
    return result.count / result.scenarios


def chance(scenarios: int, level: float) -> float:
    """Four standard errors of a rejection rate, with those of the simulated null distribution."""
    return float(4 * np.sqrt(level * (1 - level) * (1 / scenarios + 1 / SIMULATIONS)))


def slow_henze_zirkler(points: Doubles) -> float:
    """The formula of the paper, term by term, for points [K, D]."""
    n, d = points.shape
    beta = ((2 * d + 1) * n / 4) ** (1 / (d + 4)) / np.sqrt(2)
    inverse = np.linalg.inv(np.cov(points.T, bias=True).reshape(d, d))
    mean = points.mean(0)
    total = 0.0
    for x in points:
        for y in points:
            total += np.exp(-(beta**2) / 2 * (x - y) @ inverse @ (x - y)) / n
        far = (x - mean) @ inverse @ (x - mean)
        weight = np.exp(-(beta**2) / (2 * (1 + beta**2)) * far)
        total -= 2 * (1 + beta**2) ** (-d / 2) * weight
    return float(total + n * (1 + 2 * beta**2) ** (-d / 2))


def slow_dip(sample: Doubles) -> float:
    """The definition as a linear program for each mode: the nearest unimodal distribution.

    Unknown are the distribution function at each value up to the mode (there: just before it), at
    each value from the mode on, and the distance. Convex, then concave, never falling, with any
    jump at the mode. Between two values a mode can do no better than at one of them.
    """
    values, counts = np.unique(sample, return_counts=True)
    at = np.cumsum(counts) / len(sample)
    before = at - counts / len(sample)
    return min(distance_with_mode(values, before, at, mode) for mode in range(len(values)))


def distance_with_mode(values: Doubles, before: Doubles, at: Doubles, mode: int) -> float:
    left, total = mode + 1, len(values) + 2  # the mode has two values; the last is the distance
    rows: list[Doubles] = []
    limits: list[float] = []

    def at_most(limit: float, *terms: tuple[int, float]) -> None:
        row = np.zeros(total)
        for index, factor in terms:
            row[index] += factor
        rows.append(row)
        limits.append(limit)

    def close(index: int, value: float) -> None:
        at_most(value, (index, 1), (total - 1, -1))
        at_most(-value, (index, -1), (total - 1, -1))

    def bend(columns: list[int], x: Doubles, sign: float) -> None:
        for (i, j, k), (a, b, c) in zip(
            zip(columns, columns[1:], columns[2:], strict=False),
            zip(x, x[1:], x[2:], strict=False),
            strict=True,
        ):
            first, second = sign / (b - a), sign / (c - b)
            at_most(0, (i, -first), (j, first + second), (k, -second))

    for i in range(mode):
        close(i, before[i])
        close(i, at[i])
    close(mode, before[mode])
    close(left, at[mode])
    for i in range(mode + 1, len(values)):
        close(i + 1, before[i])
        close(i + 1, at[i])
    for i in range(total - 2):
        at_most(0, (i, 1), (i + 1, -1))
    bend(list(range(left)), values[:left], 1)
    bend(list(range(left, total - 1)), values[mode:], -1)
    cost = np.zeros(total)
    cost[-1] = 1
    bounds = [(0, 1)] * total
    return float(linprog(cost, A_ub=np.array(rows), b_ub=limits, bounds=bounds).fun)


@pytest.mark.parametrize(("count", "dimensions"), [(20, 1), (25, 2), (15, 3)])
def test_henze_zirkler_is_the_formula(count: int, dimensions: int) -> None:
    points = normal(3, count, dimensions) * 0.01 + 7
    slow = [slow_henze_zirkler(each) for each in points]
    np.testing.assert_allclose(henze_zirkler(points), slow, rtol=1e-9)


def test_henze_zirkler_does_not_change_under_affine_maps() -> None:
    points = banana(4, 30)
    mapped = points @ np.array([[3.0, 0.2], [-1.0, 0.01]]) + np.array([5.0, -2.0])
    np.testing.assert_allclose(henze_zirkler(mapped), henze_zirkler(points), rtol=1e-8)
    np.testing.assert_array_equal(not_gaussian(mapped), not_gaussian(points))


@pytest.mark.parametrize("dimensions", [1, 2, 3])
def test_gaussians_are_rejected_as_often_as_the_level_says(dimensions: int) -> None:
    p_values = not_gaussian(normal(1000, 40, dimensions, seed=5))
    for level in (0.01, 0.05, 0.2):
        assert abs(share(p_values, level) - level) < chance(1000, level)


def test_distributions_that_are_not_gaussian_are_rejected() -> None:
    assert share(not_gaussian(clusters(200, 100, 2, distance=4)), 0.01) > 0.85
    assert share(not_gaussian(banana(200, 60)), 0.01) > 0.95
    assert share(not_gaussian(disc(200, 100)), 0.01) > 0.8


def test_a_dimension_that_varies_in_no_scenario_is_dropped() -> None:
    points = normal(5, 30, 2)
    height = np.full((5, 30, 1), 0.3)
    with_height = np.concatenate([points, height], axis=-1)
    np.testing.assert_array_equal(not_gaussian(with_height), not_gaussian(points))


def test_a_line_is_not_gaussian_and_a_point_is_no_distribution() -> None:
    points = normal(4, 30, 2)
    points[1] = points[1, :, :1] * np.array([0.3, -2.0]) + 1  # a slanted line
    points[2, :, 1] = 0.5  # a line along an axis
    points[3] = np.array([0.25, -0.75])  # a point
    as_stored = points.astype(np.float32)
    p_values = not_gaussian(as_stored)
    assert p_values[0] > 0.01
    np.testing.assert_allclose(p_values[1:], [SMALLEST, SMALLEST, 1])
    np.testing.assert_array_equal(not_gaussian(as_stored[3:]), 1)
    assert not_unimodal(as_stored)[3] == 1


@pytest.mark.parametrize("count", [2, 5, 10, 99])
def test_the_dip_of_equally_spaced_points_is_the_least(count: int) -> None:
    assert dip(np.linspace(-3, 8, count)[None])[0] == pytest.approx(1 / (2 * count))


def test_the_dip_of_atoms() -> None:
    one, two = [[4.0] * 6], [[0.0] * 5 + [1.0] * 5]
    uneven, three = [[0.0] * 8 + [1.0] * 2], [[0.0] * 4 + [1.0] * 4 + [5.0] * 4]
    assert dip(np.array(one))[0] == 0
    assert dip(np.array(two))[0] == pytest.approx(1 / 4)  # the greatest dip there is
    assert dip(np.array(uneven))[0] == pytest.approx(1 / 10)  # half the smaller atom
    assert dip(np.array(three))[0] == pytest.approx(slow_dip(np.array(three[0])))


def test_two_uniform_clusters_have_the_dip_of_their_limit() -> None:
    # Two unit intervals a unit apart: the concave majorant from the gap on bridges 1/4.
    half = np.linspace(0, 1, 2000)
    assert dip(np.concatenate([half, half + 2])[None])[0] == pytest.approx(1 / 8, abs=1e-3)


@pytest.mark.parametrize("count", [3, 7, 12])
def test_the_dip_is_the_distance_to_the_nearest_unimodal_distribution(count: int) -> None:
    samples = np.concatenate(
        [
            normal(4, count),
            clusters(4, count, 1, distance=6)[..., 0],
            generator(2).random((4, count)) ** 3,
            generator(3).integers(0, 5, (6, count)),  # equal values
            np.where(generator(4).random((4, count)) < 0.5, 0, normal(4, count)),  # one atom
        ]
    )
    np.testing.assert_allclose(dip(samples), [slow_dip(each) for each in samples], atol=1e-9)


def test_the_dip_does_not_change_under_order_shift_scale_or_reflection() -> None:
    samples = clusters(8, 41, 1, distance=3)[..., 0]
    shuffled = generator().permuted(samples, axis=1)
    np.testing.assert_allclose(dip(3 - 0.02 * shuffled), dip(samples), atol=1e-12)


def test_uniforms_are_rejected_as_often_as_the_level_says() -> None:
    p_values = not_unimodal(generator(7).random((1000, 50, 1)))
    for level in (0.01, 0.05, 0.2):
        assert abs(share(p_values, level) - level) < chance(1000, level)


@pytest.mark.parametrize("dimensions", [2, 3])
def test_one_mode_is_seldom_rejected_though_the_direction_is_chosen(dimensions: int) -> None:
    assert share(not_unimodal(normal(1000, 60, dimensions)), 0.05) < 0.01
    assert share(not_unimodal(generator().random((1000, 60, dimensions))), 0.05) < 0.05
    assert share(not_unimodal(banana(1000, 60)), 0.05) < 0.01


def test_two_clusters_are_found_along_any_direction() -> None:
    turn = np.linalg.qr(normal(3, 3))[0]
    points = clusters(200, 100, 3, distance=6) @ turn
    assert share(not_unimodal(points), 0.01) > 0.95
    # Some rollouts miss the ball, which stays where it was; the others push it away.
    missed = clusters(200, 60, 2, distance=8)
    missed[missed[..., 0] < 4] = 0
    assert share(not_unimodal(missed), 0.01) > 0.95


def test_principal_is_the_direction_of_greatest_variance() -> None:
    points = normal(5, 40, 3) * np.array([1.0, 3.0, 0.5])
    greatest = [np.linalg.eigvalsh(np.cov(each.T, bias=True))[-1] for each in points]
    np.testing.assert_allclose(principal(points).var(1), greatest)


def test_rejections_are_counted_beside_the_number_by_chance() -> None:
    result = count_rejections(np.array([0.001, 0.01, 0.02, 0.5]), significance=0.01)
    assert (result.count, result.scenarios, result.expected) == (2, 4, pytest.approx(0.04))


def test_a_scenario_does_not_depend_on_those_beside_it() -> None:
    points = clusters(6, 30, 2, distance=4)
    np.testing.assert_array_equal(not_unimodal(points)[2:3], not_unimodal(points[2:3]))
    np.testing.assert_array_equal(not_gaussian(points)[2:3], not_gaussian(points[2:3]))


@pytest.mark.parametrize("test", [not_gaussian, not_unimodal])
def test_non_finite_points_are_refused(test: Callable[[Doubles], Doubles]) -> None:
    points = normal(2, 20, 2)
    points[0, 3, 1] = np.nan
    with pytest.raises(ValueError, match="finite"):
        test(points)


def test_too_few_points_are_refused() -> None:
    with pytest.raises(ValueError, match="3 points"):
        not_gaussian(normal(2, 3, 2))
