"""What the scenarios of an environment are like, in numbers."""

from dataclasses import dataclass

import numpy as np

from study.data.trajectories import ScenarioSet
from study.envs import Simulator
from study.envs.card.histogram import uncertain
from study.metrics.normality import count_rejections, not_gaussian, not_unimodal

LEVEL = 0.01
"""Of the tests on the shape of distributions."""


@dataclass(frozen=True)
class Event:
    """How often something happens: in a share of all rollouts, in some of so many scenarios."""

    name: str
    share: float
    scenarios: int


@dataclass(frozen=True)
class Facts:
    """S scenarios, rolled out K times each.

    Attributes:
        scenarios, rollouts: S and K.
        nominal: share of scenarios whose plan succeeds on the nominal system.
        base_rate: share of all rollouts that succeed.
        uncertain: share of scenarios of which more than 0.1 and fewer than 0.9 succeed.
        oracle: Brier score of the true probability, mean p (1 − p), without bias: no forecast can
            have a lower one.
        climatology: Brier score of the base rate.
        not_gaussian, not_unimodal: scenarios whose final `position` is found to be so at `LEVEL`.
        by_chance: how many of each would be, at most, if all were Gaussian with one mode.
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
    by_chance: float
    events: tuple[Event, ...]


def facts(simulator: Simulator, observed: ScenarioSet) -> Facts:
    """Measure them on a test set."""
    count, rollouts = observed.observed.shape[:2]
    success = simulator.outcome(observed.observed, observed.goal[:, None])
    probability = success.mean(axis=1)
    base_rate = float(probability.mean())
    nominal = simulator.rollout(observed.s0, observed.actions).states[:, 1:]
    ends = simulator.position(observed.observed[:, :, -1]).astype(np.float64)
    gaussian = count_rejections(not_gaussian(ends), LEVEL)
    unimodal = count_rejections(not_unimodal(ends), LEVEL)
    s0 = np.broadcast_to(observed.s0[:, None, None], (count, rollouts, 1, observed.s0.shape[-1]))
    events = simulator.events(np.concatenate([s0, observed.observed], axis=2))
    return Facts(
        scenarios=count,
        rollouts=rollouts,
        nominal=float(simulator.outcome(nominal, observed.goal).mean()),
        base_rate=base_rate,
        uncertain=uncertain(success),
        oracle=float((probability * (1 - probability)).mean() * rollouts / (rollouts - 1)),
        climatology=base_rate * (1 - base_rate),
        not_gaussian=gaussian.count,
        not_unimodal=unimodal.count,
        by_chance=gaussian.expected,
        events=tuple(
            Event(name, float(happened.mean()), int(happened.any(axis=1).sum()))
            for name, happened in events.items()
        ),
    )


def rows(facts: Facts) -> list[tuple[str, str]]:
    """What each number is, and the number."""
    of = f"of {facts.scenarios}"
    by_chance = f"(by chance at most {facts.by_chance:.1f})"
    return [
        ("scenarios, rollouts of each", f"{facts.scenarios}, {facts.rollouts}"),
        ("plans that succeed on the noise-free system", f"{facts.nominal:.1%}"),
        ("base rate: rollouts that succeed", f"{facts.base_rate:.3f}"),
        ("scenarios with a probability of success between 0.1 and 0.9", f"{facts.uncertain:.1%}"),
        ("Brier score of the true probabilities: no forecast can be better", f"{facts.oracle:.3f}"),
        ("Brier score of the base rate", f"{facts.climatology:.3f}"),
        (
            f"final positions that are not Gaussian (Henze-Zirkler test, level {LEVEL})",
            f"{facts.not_gaussian} {of} {by_chance}",
        ),
        (
            f"final positions with more than one mode (dip test along the widest direction, "
            f"level {LEVEL})",
            f"{facts.not_unimodal} {of} {by_chance}",
        ),
        *(
            (event.name, f"{event.share:.1%} of rollouts; in some of {event.scenarios} {of}")
            for event in facts.events
        ),
    ]
