"""Brier score of forecast outcomes: the mean squared error of a probability (Brier 1950).

See section III-D of the paper. The forecast probability p of a scenario is the share of its K
samples in which the outcome happens. The score is the mean of (p - o)² over the outcomes o of all
observed rollouts of the scenario.

**Non-finite forecasts.** A sample with a non-finite value has no outcome. It counts as wrong
against each observation: as success where the rollout failed, and as failure where the rollout
succeeded. No outcomes in its place score worse.

*Skill* places a mean score between that of the climatology (0) and that of the oracle (1). Tables,
pages, validation and ablations define it alike: the function `skill` of the mean fair score
(`brier_fair`), with the expected score of an oracle that knows the probabilities (`brier_oracle`).
"""

import numpy as np

from study.common.arrays import Array, Doubles

SMALLEST_RANGE = 0.002
"""Smallest difference of the climatology's and the oracle's scores for which skill is defined."""


def brier(forecast: Array, observed: Array, valid: Array | None = None) -> Doubles:
    """Brier score of each scenario [S, ...]: 0 is best; p = 1/2 always scores 0.25.

    Args:
        forecast: [S, K, ...] bool, whether the outcome happens in each sample. Each element of the
            trailing axes, such as steps, is scored separately.
        observed: [S, L, ...] bool, whether the outcome happens in each rollout.
        valid: [S, K] bool, which samples are finite; all if None.
    """
    base, if_success, if_failure = _probabilities(forecast, observed, valid)
    return base * (1 - if_success) ** 2 + (1 - base) * if_failure**2


def brier_fair(forecast: Array, observed: Array, valid: Array | None = None) -> Doubles:
    """Fair Brier score of each scenario [S, ...]: the score without the error of finite sampling.

    The share p of K independent samples estimates a probability π. Its expected score is
    π (1 - π) / K above that of π. The fair score subtracts p (1 - p) / (K - 1), an unbiased
    estimate of this excess (Ferro 2014, "Fair scores for ensemble forecasts", eq. 6). Its
    expectation is the score of π for any K, so forecasters with different K are comparable. It can
    be negative by chance. With non-finite samples, the expectation is the score of infinitely many
    samples with the same share of non-finite ones.

    The arguments are those of `brier`.

    Raises:
        ValueError: fewer than two samples.
    """
    samples = np.shape(forecast)[1]
    if samples < 2:
        raise ValueError(f"a fair score needs 2 samples or more, not {samples}")
    base, if_success, if_failure = _probabilities(forecast, observed, valid)
    excess = base * if_success * (1 - if_success) + (1 - base) * if_failure * (1 - if_failure)
    return brier(forecast, observed, valid) - excess / (samples - 1)


def _probabilities(
    forecast: Array, observed: Array, valid: Array | None
) -> tuple[Doubles, Doubles, Doubles]:
    """Three arrays [S, ...]: base rate, forecast scored on success, forecast scored on failure.

    The two forecasts differ by the share of samples that are not finite.
    """
    forecast, observed = np.asarray(forecast, bool), np.asarray(observed, bool)
    if valid is None:
        valid = np.ones(forecast.shape[:2], bool)
    valid = np.asarray(valid, bool).reshape(*valid.shape, *[1] * (forecast.ndim - 2))
    return observed.mean(1), (forecast & valid).mean(1), (forecast | ~valid).mean(1)


def two_class(score: Doubles) -> Doubles:
    """Brier's original form, summed over the two classes: twice the binary score."""
    return 2 * score


def climatology(observed: Array) -> Doubles:
    """Brier score of each scenario [S, ...] of the climatology: the base rate as the forecast.

    The base rate is the share of successes over all scenarios and rollouts. The climatology does
    not use the scenario.

    Args:
        observed: [S, L, ...] bool, whether the outcome happens in each rollout.
    """
    per_scenario = np.asarray(observed, bool).mean(1)
    base = per_scenario.mean(0)
    return per_scenario * (1 - base) ** 2 + (1 - per_scenario) * base**2


def brier_oracle(probability: Array, rollouts: int) -> Doubles:
    """Expected fair Brier score of each scenario [S] of the oracle: the variance of the outcome.

    The oracle forecasts the true probability of each scenario. The estimate is unbiased.

    Args:
        probability: [S], the share of the observed rollouts in which the outcome happens.
        rollouts: L ≥ 2, their number.
    """
    share = np.asarray(probability, np.float64)
    return share * (1 - share) * rollouts / (rollouts - 1)


def skill(score: float, oracle: float, climatology: float) -> float:
    """Skill of a mean fair Brier score: 0 for the climatology's score, 1 for the oracle's.

    Args:
        score: the mean of `brier_fair`.
        oracle: the mean of `brier_oracle`.
        climatology: the mean of `climatology`.

    Returns:
        (climatology - score) / (climatology - oracle), or NaN where the oracle's score is less than
        `SMALLEST_RANGE` below the climatology's. There the ratio is noise.
    """
    known = climatology - oracle >= SMALLEST_RANGE
    return (climatology - score) / (climatology - oracle) if known else float("nan")
