"""Kernel means against the double sum, for numbers in many arrangements."""

import numpy as np
import pytest

from study.common.arrays import Doubles
from study.metrics import kernel_sums
from study.metrics.kernel_sums import ERROR, FARTHEST, REACH, WIDE, gaps

INFINITE = 1e15


def slow(x: Doubles, y: Doubles, factor: float) -> Doubles:
    """Mean of 1 - exp(-(u / f)²) over all pairs, [C]."""
    apart = (x[:, None] - y[None]) / factor
    return np.asarray(-np.expm1(-(apart**2)).mean((0, 1)))


def check(x: Doubles, y: Doubles, *factors: float) -> None:
    found = gaps(x, y, factors)
    for index, factor in enumerate(factors):
        for part, pair in (
            (found.among_x, (x, x)),
            (found.among_y, (y, y)),
            (found.across, (x, y)),
        ):
            np.testing.assert_allclose(part[index], slow(*pair, factor), rtol=0, atol=ERROR)


def normal(*shape: int, seed: int = 0) -> Doubles:
    return np.random.default_rng(seed).standard_normal(shape)


def clustered(*shape: int, seed: int = 0) -> Doubles:
    """Clusters hundreds of reaches apart, and some alone."""
    rng = np.random.default_rng(seed)
    numbers = 1000.0 * rng.integers(-2, 3, shape) + rng.standard_normal(shape)
    numbers[0] = INFINITE
    return np.asarray(numbers)


SCALES = np.logspace(-8, 7, 40)
CASES = {
    "ordinary": (normal(30, 40), 0.8 * normal(20, 40, seed=1) + 0.3),
    "every deviation": (SCALES * normal(30, 40), SCALES[::-1] * normal(20, 40, seed=1)),
    "every distance": (normal(30, 40) + SCALES, normal(20, 40, seed=1)),
    "a thousand widths apart": (normal(30, 9) + 1000, normal(20, 9, seed=1)),
    "clusters": (clustered(30, 9), clustered(20, 9, seed=1)),
    "uniform": (
        np.random.default_rng(0).uniform(-400, 400, (60, 9)),
        np.random.default_rng(1).uniform(-400, 400, (70, 9)),
    ),
    "tied": (np.floor(3 * normal(30, 9)), np.floor(3 * normal(20, 9, seed=1))),
    "tied and far": (np.floor(normal(30, 9)) * 50, np.floor(normal(20, 9, seed=1)) * 50),
    "partly at infinity": (
        np.where(normal(30, 9) > 1, INFINITE, normal(30, 9, seed=2)),
        normal(20, 9, seed=1),
    ),
    "two against one": (normal(2, 9), normal(1, 9, seed=1)),
    "one column": (normal(5, 1) * 100, normal(4, 1, seed=1)),
}


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("factors", [(1.0,), (0.5, 1.0, 2.0), (1.7, 0.3)])
def test_agrees_with_the_double_sum(case: str, factors: tuple[float, ...]) -> None:
    check(*CASES[case], *factors)


@pytest.mark.parametrize("span", [0.0, 0.1, 2 * REACH, WIDE * REACH, WIDE * REACH + 1e-6, 1e4])
def test_numbers_at_the_ends_of_a_series(span: float) -> None:
    """The worst case: errors by images and high frequencies do not average out."""
    x, y = np.array([[0.0], [span]]), np.array([[span], [span]])
    check(x, y, 1.0)
    check(x, y, 0.5, 2.0)


@pytest.mark.parametrize("distance", np.linspace(0.5, 3, 11) * REACH)
def test_bins_lose_no_pair_at_their_edges(distance: float) -> None:
    start = np.linspace(0, REACH, 7)
    far = np.full(7, 1e4)  # forces bins
    check(np.stack([start, far]), np.stack([start + distance, start - distance, far]), 1.0)


def test_equal_numbers_have_no_gap_at_all() -> None:
    still = np.full((7, 3), 0.1)
    found = gaps(still, still[:4], (0.5, 1.0))
    for part in (found.among_x, found.among_y, found.across):
        assert not part.any()


def test_columns_and_blocks_do_not_affect_each_other(monkeypatch: pytest.MonkeyPatch) -> None:
    x, y = CASES["every deviation"]
    whole = gaps(x, y)
    monkeypatch.setattr(kernel_sums, "BLOCK", 1)
    alone = gaps(x, y)
    np.testing.assert_allclose(whole.across, alone.across, rtol=0, atol=2 * ERROR)
    np.testing.assert_allclose(whole.among_x, alone.among_x, rtol=0, atol=2 * ERROR)


def test_the_same_input_gives_the_same_bytes() -> None:
    for x, y in CASES.values():
        first, second = gaps(x, y), gaps(x.copy(), y.copy())
        assert first.across.tobytes() == second.across.tobytes()
        assert first.among_x.tobytes() == second.among_x.tobytes()


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 2 * FARTHEST])
def test_non_finite_and_distant_numbers_are_refused(bad: float) -> None:
    x = normal(4, 2)
    x[1, 1] = bad
    with pytest.raises(ValueError, match="not finite, or too far apart"):
        gaps(x, normal(3, 2))
