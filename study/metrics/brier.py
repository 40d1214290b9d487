"""Brier score of forecast outcomes: the mean squared error of a probability (Brier 1950).

Section IV-D of the paper. The forecast probability p of a scenario is the share of its K samples
in which the goal succeeds, and the score is the mean of (p - o)² over the outcomes o of *every*
observed rollout of the scenario. A sample that holds a value that is not finite has no outcome: it
counts as the wrong one against each observation, as success where the rollout failed and as
failure where it succeeded.
"""

import numpy as np

from study.common.arrays import Array, Doubles


def brier(forecast: Array, observed: Array, valid: Array | None = None) -> Doubles:
    """Brier score of each scenario [S, ...]: 0 is best; 0.25 for p = 1/2 whatever happens.

    Args:
        forecast: [S, K, ...] bool, whether the goal succeeds in each sample. What follows the
            first two axes (steps, say) is scored on its own.
        observed: [S, L, ...] bool, whether it did in each rollout.
        valid: [S, K] bool, which samples are finite throughout; all if None.
    """
    base, if_success, if_failure = _probabilities(forecast, observed, valid)
    return base * (1 - if_success) ** 2 + (1 - base) * if_failure**2


def brier_fair(forecast: Array, observed: Array, valid: Array | None = None) -> Doubles:
    """Fair Brier score of each scenario [S, ...]: of the forecaster, not of its K samples.

    A share p of K independent samples scores p (1 - p) / K worse, on average, than the probability
    π that it estimates. Without p (1 - p) / (K - 1), an unbiased estimate of that excess, the
    score expects what π itself would score, whatever K is (Ferro 2014, "Fair scores for ensemble
    forecasts", eq. 6). Forecasters with different numbers of samples can be compared, and good
    ones can score less than 0 where they happen to be lucky. Where samples are not finite, each
    observation is scored with its own p (see the module): the expectation is the score of
    infinitely many samples, the same share of which are not finite.

    Arguments as of `brier`.

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
    """Share of rollouts that succeed, and the forecast that is scored if they do, if they do not.

    The two forecasts differ by the share of samples that are not finite. [S, ...] each.
    """
    forecast, observed = np.asarray(forecast, bool), np.asarray(observed, bool)
    if valid is None:
        valid = np.ones(forecast.shape[:2], bool)
    valid = np.asarray(valid, bool).reshape(*valid.shape, *[1] * (forecast.ndim - 2))
    return observed.mean(1), (forecast & valid).mean(1), (forecast | ~valid).mean(1)


def two_class(score: Doubles) -> Doubles:
    """Brier's own form, summed over the classes success and failure: twice the binary score."""
    return 2 * score


def climatology(observed: Array) -> Doubles:
    """Brier score of each scenario [S, ...] of the forecast that always gives the base rate.

    The base rate is the share of successes over all scenarios and rollouts [S, L, ...]. A forecast
    that scores worse knows less than one that does not look at the scenario.
    """
    per_scenario = np.asarray(observed, bool).mean(1)
    base = per_scenario.mean(0)
    return per_scenario * (1 - base) ** 2 + (1 - per_scenario) * base**2


def skill(score: float, oracle: float, reference: float) -> float:
    """Where a score lies between the climatology (`reference`, skill 0) and the oracle (skill 1).

    NaN when the two are equal: then there is nothing to know.
    """
    return (reference - score) / (reference - oracle) if reference != oracle else float("nan")
