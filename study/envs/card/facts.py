"""Facts about the scenarios of an environment: how uncertain their outcomes are."""

from dataclasses import dataclass

import numpy as np

from study.data.trajectories import ScenarioSet
from study.envs import Simulator
from study.envs.card.histogram import uncertain
from study.metrics.brier import brier_oracle
from study.metrics.normality import count_rejections, not_gaussian, not_unimodal

LEVEL = 0.01
"""Significance level of the tests on the shape of distributions."""


@dataclass(frozen=True)
class Event:
    """How often an event happens.

    Attributes:
        name: a sentence.
        share: share of all rollouts.
        scenarios: number of scenarios with the event in at least one rollout.
    """

    name: str
    share: float
    scenarios: int


@dataclass(frozen=True)
class Facts:
    """Facts about S scenarios with K rollouts each.

    Attributes:
        scenarios: S.
        rollouts: K.
        nominal: share of the scenarios whose plan reaches the goal on the nominal system.
        base_rate: share of all rollouts that reach the goal.
        uncertain: share of the scenarios with a probability of success between 0.1 and 0.9.
        oracle: unbiased estimate of the mean of p (1 − p), the Brier score of the true
            probabilities and the lowest possible one.
        climatology: Brier score of the base rate.
        not_gaussian: number of scenarios for which a Gaussian final `position` is rejected.
        not_unimodal: number of scenarios for which a unimodal final `position` is rejected.
        expected: largest expected number of false rejections, for each of the two tests.
        events: see `Simulator.events`.
    """

    scenarios: int
    rollouts: int
    nominal: float
    base_rate: float
    uncertain: float
    oracle: float
    climatology: float
    not_gaussian: int
    not_unimodal: int
    expected: float
    events: tuple[Event, ...]


def measure(simulator: Simulator, scenarios: ScenarioSet) -> Facts:
    """The facts about a set of scenarios."""
    count, rollouts = scenarios.observed.shape[:2]
    success = simulator.outcome(scenarios.observed, scenarios.goal[:, None])
    probability = success.mean(axis=1)
    base_rate = float(probability.mean())
    nominal = simulator.rollout(scenarios.s0, scenarios.actions).states[:, 1:]
    ends = simulator.position(scenarios.observed[:, :, -1]).astype(np.float64)
    gaussian = count_rejections(not_gaussian(ends), LEVEL)
    unimodal = count_rejections(not_unimodal(ends), LEVEL)
    s0 = np.broadcast_to(scenarios.s0[:, None, None], (count, rollouts, 1, scenarios.s0.shape[-1]))
    events = simulator.events(np.concatenate([s0, scenarios.observed], axis=2))
    return Facts(
        scenarios=count,
        rollouts=rollouts,
        nominal=float(simulator.outcome(nominal, scenarios.goal).mean()),
        base_rate=base_rate,
        uncertain=uncertain(success),
        oracle=float(brier_oracle(probability, rollouts).mean()),
        climatology=base_rate * (1 - base_rate),
        not_gaussian=gaussian.count,
        not_unimodal=unimodal.count,
        expected=gaussian.expected,
        events=tuple(
            Event(name, float(happened.mean()), int(happened.any(axis=1).sum()))
            for name, happened in events.items()
        ),
    )


def rows(facts: Facts) -> list[tuple[str, str]]:
    """The rows of a table: quantity and value."""
    of = f"of {facts.scenarios}"
    by_chance = f"(expected by chance: at most {facts.expected:.1f})"
    return [
        ("scenarios", f"{facts.scenarios}"),
        ("rollouts of each scenario", f"{facts.rollouts}"),
        ("plans that reach the goal on the noise-free system", f"{facts.nominal:.1%}"),
        ("base rate: rollouts that reach the goal", f"{facts.base_rate:.3f}"),
        ("scenarios with a probability of success between 0.1 and 0.9", f"{facts.uncertain:.1%}"),
        ("Brier score of the true probabilities, the lowest possible", f"{facts.oracle:.3f}"),
        ("Brier score of the base rate", f"{facts.climatology:.3f}"),
        (
            f"scenarios with non-Gaussian final positions (Henze-Zirkler test, level {LEVEL})",
            f"{facts.not_gaussian} {of} {by_chance}",
        ),
        (
            f"scenarios with multimodal final positions (dip test along the direction of largest "
            f"variance, level {LEVEL})",
            f"{facts.not_unimodal} {of} {by_chance}",
        ),
        *(
            (
                f"event: {event.name}",
                f"{event.share:.1%} of the rollouts, in {event.scenarios} {of} scenarios",
            )
            for event in facts.events
        ),
    ]
