"""Joint MMD against a double loop, and its sensitivity to dependence between dimensions."""

import numpy as np
import pytest

from study.common.arrays import Doubles, Floats
from study.metrics import joint_mmd as module
from study.metrics.joint_mmd import joint_mmd
from study.metrics.mmd import bandwidths, mmd

SCALE = np.array([2.0, 0.5, 1.0])
BANDWIDTH = np.array([0.7, 1.3, 0.4])


def normal(*shape: int, seed: int = 0) -> Floats:
    return np.random.default_rng(seed).standard_normal(shape, dtype=np.float32)


def kernels(x: Floats, y: Floats) -> Doubles:
    """The geometric mean of the kernels of the dimensions, pair by pair, [K, L]."""
    found = np.ones((len(x), len(y)))
    for i, j in np.ndindex(len(x), len(y)):
        for d in range(x.shape[1]):
            apart = (float(x[i, d]) - float(y[j, d])) / (SCALE[d] * BANDWIDTH[d])
            found[i, j] *= np.exp(-(apart**2) / 2) ** (1 / x.shape[1])
    return found


def slow(x: Floats, y: Floats) -> tuple[float, float]:
    """Unbiased MMD² and biased MMD of states x [K, D] and y [L, D], by definition."""
    among, across = (kernels(x, x), kernels(y, y)), kernels(x, y).mean()
    unbiased = sum((k.sum() - len(k)) / (len(k) * (len(k) - 1)) for k in among) - 2 * across
    biased = sum(k.mean() for k in among) - 2 * across
    return unbiased, np.sqrt(biased)


@pytest.mark.parametrize(
    ("deviation", "offset"), [(1.0, 30.0), (100.0, 0.0), (1.0, 5e3), (1e5, 0.0), (1e-3, 1.0)]
)
@pytest.mark.parametrize("samples", [2, 7])
def test_agrees_with_a_double_loop(deviation: float, offset: float, samples: int) -> None:
    forecast = deviation * normal(2, samples, 3, 3) + np.float32(offset)
    observed = normal(2, 4, 3, 3, seed=1)
    result = joint_mmd(forecast, observed, SCALE, BANDWIDTH)
    for s, t in np.ndindex(2, 3):
        unbiased, biased = slow(forecast[s, :, t], observed[s, :, t])
        assert result.squared[s, t] == pytest.approx(unbiased, abs=1e-7)
        assert result.biased[s, t] == pytest.approx(biased, abs=1e-4)
        assert result.biased[s, t] ** 2 == pytest.approx(biased**2, abs=1e-7)


def test_of_one_dimension_it_is_mmd() -> None:
    forecast, observed = normal(3, 6, 4, 1), normal(3, 5, 4, 1, seed=1)
    one = joint_mmd(forecast, observed, SCALE[:1], BANDWIDTH[:1])
    other = mmd(forecast, observed, SCALE[:1], BANDWIDTH[:1])
    np.testing.assert_allclose(one.squared, other.squared[..., 0], rtol=0, atol=1e-7)
    np.testing.assert_allclose(one.biased, other.biased[..., 0], rtol=0, atol=1e-4)


def test_it_depends_on_dependence_between_dimensions() -> None:
    observed, ones = normal(10, 60, 20, 2), np.ones(2)
    observed[..., 1] = 0.9 * observed[..., 0] + np.sqrt(0.19) * observed[..., 1]
    shuffled = observed.copy()
    # The second dimension of another rollout: the same marginals, another dependence.
    shuffled[..., 1] = np.roll(shuffled[..., 1], 1, axis=1)
    fresh = normal(10, 60, 20, 2, seed=1)
    fresh[..., 1] = 0.9 * fresh[..., 0] + np.sqrt(0.19) * fresh[..., 1]
    bandwidth = bandwidths(observed, ones)
    biased = mmd(shuffled, observed, ones, bandwidth).biased
    np.testing.assert_allclose(biased, 0, atol=1e-7)
    floor = joint_mmd(fresh, observed, ones, bandwidth).squared
    error = floor.std() / np.sqrt(floor.size)
    # Unbiased: zero for equal distributions.
    assert floor.mean() == pytest.approx(0, abs=4 * error)
    assert joint_mmd(shuffled, observed, ones, bandwidth).squared.mean() > 0.02 > 10 * error


@pytest.mark.parametrize("dimensions", [2, 12, 17])
def test_the_mean_kernel_does_not_depend_on_the_number_of_dimensions(dimensions: int) -> None:
    observed = normal(5, 40, 6, dimensions)
    ones = np.ones(dimensions)
    far = np.full_like(observed, 1e6)
    # MMD² with a distant point is 1 + the mean kernel of the observed.
    squared = joint_mmd(far, observed, ones, bandwidths(observed, ones)).squared
    assert squared.mean() - 1 == pytest.approx(0.4, abs=0.1)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 3e38])
def test_one_non_finite_value_makes_the_state_the_worst_case(bad: float) -> None:
    observed = normal(1, 6, 1, 3)
    not_finite = normal(1, 5, 1, 3, seed=1)
    not_finite[..., 1] = bad
    result = joint_mmd(not_finite, observed, SCALE, BANDWIDTH).squared.item()
    among = kernels(observed[0, :, 0], observed[0, :, 0])
    assert result == pytest.approx(1 + (among.sum() - 6) / 30, abs=1e-7)
    for offset in (0.0, 3.0, 1e6):
        finite = np.full_like(not_finite, offset)
        assert joint_mmd(finite, observed, SCALE, BANDWIDTH).squared.item() <= result + 1e-7


def test_a_share_that_is_not_finite_costs_its_share() -> None:
    forecast, observed = normal(1, 5, 1, 3), normal(1, 6, 1, 3, seed=1)
    forecast[0, 0, 0, 0], forecast[0, 1, 0, 2] = np.nan, np.inf
    x, y = forecast[0, 2:, 0], observed[0, :, 0]
    pairs = (kernels(x, x).sum() - 3) / 2 + 7  # three finite pairs, seven with kernel 1
    expected = pairs / 10 + (kernels(y, y).sum() - 6) / 30 - 2 * kernels(x, y).sum() / 30
    result = joint_mmd(forecast, observed, SCALE, BANDWIDTH).squared.item()
    assert result == pytest.approx(expected, abs=1e-7)


def test_states_that_never_vary_score_zero() -> None:
    still = np.ones((2, 4, 3, 2), np.float32)
    result = joint_mmd(still, still, np.zeros(2), np.ones(2))
    assert not result.squared.any()
    assert not result.biased.any()


def test_how_many_steps_at_once_does_not_matter(monkeypatch: pytest.MonkeyPatch) -> None:
    forecast, observed = normal(2, 5, 9, 3), normal(2, 4, 9, 3, seed=1)
    shares: list[float] = []
    whole = joint_mmd(forecast, observed, SCALE, BANDWIDTH, shares.append)
    assert shares == [0.5, 1.0]
    monkeypatch.setattr(module, "AT_ONCE", 1)
    single = joint_mmd(forecast, observed, SCALE, BANDWIDTH)
    np.testing.assert_allclose(whole.squared, single.squared, rtol=0, atol=1e-7)


def test_bad_observations_and_too_few_samples_are_refused() -> None:
    observed = normal(2, 5, 3, 3)
    with pytest.raises(ValueError, match="at least two"):
        joint_mmd(observed[:, :1], observed, SCALE, BANDWIDTH)
    with pytest.raises(ValueError, match="at least two"):
        joint_mmd(observed, observed[:, :0], SCALE, BANDWIDTH)
    observed[1, 2, 0, 1] = np.nan
    with pytest.raises(ValueError, match="not finite"):
        joint_mmd(observed, observed, SCALE, BANDWIDTH)
