"""What a claim is: contrasts of mean scores, and a rule that decides each of them."""

from dataclasses import dataclass
from enum import Enum

from study.config.names import label

SMALLEST_EFFECTS = {
    "mmd2": 0.002,
    "brier": 0.01,
    "energy_score": 0.005,
    "log_aleatoric_error": 0.05,
    "log_aleatoric_ratio": 0.05,
}
"""Smallest effect of interest (SESOI) of each metric. All were fixed before any run.

- MMD²: the MMD² of two normal distributions whose means are 0.1 standard deviations apart, with the
  bandwidth of the median heuristic.
- Brier score: the excess score of a probability that is wrong by 0.1.
- Energy score: 0.005 standard deviations of the training data.
- Aleatoric variance: 0.05 of the logarithm of the ratio to the true variance, a factor of about 5
  %.
"""

EQUIVALENCE_MARGIN = 0.25
"""Two values are comparable if they differ by less than this share of their mean."""


class Rule(Enum):
    """When a contrast holds, and when it is contradicted; otherwise it is undecided.

    A contrast has an effect and a 95 % interval of the effect.
    """

    ABOVE = "above zero"
    """Holds if the whole interval is above 0 and the effect is at least the smallest effect of
    interest. Contradicted if the whole interval is below 0 and the effect is below 0 by at least as
    much."""
    EQUAL = "within a margin of zero"
    """Holds if the whole interval is within the margin around 0 (an equivalence test). Contradicted
    if the whole interval is outside the margin."""
    NOT_BELOW = "not below zero"
    """Holds if the whole interval is above minus the smallest effect of interest (a non-inferiority
    test). Contradicted as `ABOVE`."""


@dataclass(frozen=True)
class Quantity:
    """The mean of a metric over scenarios (over dimensions, for variances) and seeds."""

    metric: str
    environment: str
    level: str
    model: str


@dataclass(frozen=True)
class Contrast:
    """A weighted sum of quantities, with a description."""

    text: str
    terms: tuple[tuple[float, Quantity], ...]


@dataclass(frozen=True)
class Claim:
    """A statement that scores can decide: of the paper's results section, or a check of our own.

    Attributes:
        id: its name.
        section: of the paper; `OURS` for a check.
        text: the statement.
        contrasts: all must hold for the claim to be reproduced.
        rule: decides each contrast.
        smallest_effect: of interest, in units of the metric.
        figure: where to see it, relative to the folder of the results.
    """

    id: str
    section: str
    text: str
    contrasts: tuple[Contrast, ...]
    rule: Rule
    smallest_effect: float
    figure: str


OURS = "ours"
"""The section of checks that are not claims of the paper."""


def difference(metric: str, environment: str, level: str, lower: str, higher: str) -> Contrast:
    """The score of the model `higher` minus that of the model `lower`."""
    return Contrast(
        f"{label(higher)} minus {label(lower)}",
        (
            (1.0, Quantity(metric, environment, level, higher)),
            (-1.0, Quantity(metric, environment, level, lower)),
        ),
    )


def rise(metric: str, environment: str, model: str) -> Contrast:
    """The score of a model at high epistemic uncertainty minus that at low."""
    return Contrast(
        f"{label(model)}, high minus low",
        (
            (1.0, Quantity(metric, environment, "high", model)),
            (-1.0, Quantity(metric, environment, "low", model)),
        ),
    )


def minus(first: Contrast, second: Contrast, text: str) -> Contrast:
    """The difference of two contrasts."""
    negated = tuple((-weight, quantity) for weight, quantity in second.terms)
    return Contrast(text, first.terms + negated)
