"""Brier score of forecast outcomes: the mean squared error of a probability (Brier 1950).

Section IV-D of the paper. The forecast probability p of a scenario is the share of its K samples
in which the task succeeds, and the score is the mean of (p - o)² over the outcomes o of *every*
observed rollout of the scenario. A sample that holds a value that is not finite has no outcome: it
counts as the wrong one against each observation, as success where the rollout failed and as
failure where it succeeded.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]
Doubles = NDArray[np.float64]


def brier(forecast: Array, observed: Array, valid: Array | None = None) -> Doubles:
    """Brier score of each scenario [S]: 0 is best; 0.25 for p = 1/2 whatever happens.

    Args:
        forecast: [S, K] bool, whether the task succeeds in each sample.
        observed: [S, L] bool, whether it did in each rollout.
        valid: [S, K] bool, which samples are finite throughout; all if None.
    """
    forecast, observed = np.asarray(forecast, bool), np.asarray(observed, bool)
    valid = np.ones_like(forecast) if valid is None else np.asarray(valid, bool)
    base = observed.mean(1)
    if_success = (forecast & valid).mean(1)
    if_failure = (forecast | ~valid).mean(1)
    return base * (1 - if_success) ** 2 + (1 - base) * if_failure**2


def two_class(score: Doubles) -> Doubles:
    """Brier's own form, summed over the classes success and failure: twice the binary score."""
    return 2 * score


def climatology(observed: Array) -> Doubles:
    """Brier score of each scenario [S] of the forecast that always gives the base rate.

    The base rate is the share of successes over all scenarios and rollouts [S, L]. A forecast that
    scores worse knows less than one that does not look at the scenario.
    """
    per_scenario = np.asarray(observed, bool).mean(1)
    base = per_scenario.mean()
    return per_scenario * (1 - base) ** 2 + (1 - per_scenario) * base**2


def skill(score: float, oracle: float, reference: float) -> float:
    """Where a score lies between the climatology (`reference`, skill 0) and the oracle (skill 1).

    NaN when the two are equal: then there is nothing to know.
    """
    return (reference - score) / (reference - oracle) if reference != oracle else float("nan")
