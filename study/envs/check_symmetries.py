"""Check the symmetries that a simulator declares against its own rollouts.

On the nominal system the transformed rollout has to be the rollout of the transformed start and
actions, to the rounding of float32 states. `Simulator.rollout` takes the seeds of the noise and not
the noise itself, so noise cannot be transformed. Noisy rollouts are compared by their distribution.

A scenario is left out of the comparison if rounding alone changes its rollout, such as a hit or a
miss by a hair, or if an event happens in it that `Turn.broken_by` names.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.stats import ks_2samp

from study.common.arrays import Booleans, Doubles, Floats
from study.common.contract import CheckFailed
from study.common.registry import full_name
from study.common.seeds import spawn
from study.data.symmetries import Names, Turn
from study.data.transformations import AffineMaps, SymmetryGroup, Transformations
from study.envs.simulator import Simulator

SCENARIOS = 128
"""Scenarios on the nominal system."""
NOISY_SCENARIOS, ROLLOUTS = 16, 64
"""Scenarios with noise, and rollouts of each."""
TOLERANCE = 1e-3
"""Largest difference between two rollouts that are equal to rounding, in standard deviations."""
NUDGES, ROUNDING = 2, 2.0**-22
"""Rollouts that measure the effect of rounding, and the relative change of their start: four times
the rounding of float32."""
LEVEL = 1e-6
"""Significance level of the comparison of two distributions."""


@dataclass(frozen=True)
class SymmetryCheck:
    """How well one kind of transformation holds on the nominal system.

    Attributes:
        name: the kind, such as "mirror".
        scenarios: number of scenarios.
        left_out: number of those that are left out.
        difference: largest difference in the others, in standard deviations of the component.
    """

    name: str
    scenarios: int
    left_out: int
    difference: float


@dataclass(frozen=True)
class _Kind:
    """One kind of transformation, and its parameters for N scenarios.

    Attributes:
        name: of the kind.
        angle, mirrored, shift: see `SymmetryGroup.transformations`.
        broken_by: events that break it.
    """

    name: str
    angle: Doubles
    mirrored: Booleans
    shift: Doubles
    broken_by: Names = ()


def check_symmetries(simulator: Simulator) -> list[SymmetryCheck]:
    """Check every kind of transformation of `Simulator.symmetries`.

    Returns:
        The kinds, with the number of scenarios that were left out.

    Raises:
        CheckFailed: a transformed rollout differs; the error names the component.
    """
    if not simulator.symmetries:
        return []
    check = _Check(simulator)
    return [check.run(kind) for kind in _kinds(simulator, SCENARIOS)]


def _kinds(simulator: Simulator, count: int) -> Iterator[_Kind]:
    """The kinds of transformations that a simulator declares."""
    symmetries, generator = simulator.symmetries, np.random.default_rng(0)
    turn, shifts = symmetries.turn, symmetries.shifts
    zero, never, still = np.zeros(count), np.zeros(count, bool), np.zeros((count, len(shifts)))
    if turn != Turn():
        quarters = np.asarray(generator.integers(1, 4, count) * (np.pi / 2))
        yield _Kind("quarter turns", quarters, never, still)
        if not turn.quarter:
            angle = generator.uniform(-np.pi, np.pi, count)
            yield _Kind("turns by any angle", angle, never, still, turn.broken_by)
    if symmetries.mirror.states:
        yield _Kind("mirror", zero, ~never, still)
    if shifts:
        low, high = (np.array([getattr(shift, end) for shift in shifts]) for end in ("low", "high"))
        amounts = generator.uniform(low, high, (count, len(shifts)))
        yield _Kind("shifts", zero, never, amounts)


class _Check:
    """The checks of one simulator, and the rollouts with which it is compared."""

    def __init__(self, simulator: Simulator) -> None:
        self.simulator, self.subject = simulator, f"{full_name(type(simulator))}.symmetries"
        groups = (simulator.state, simulator.action, simulator.goal)
        names = [[variable.name for variable in group] for group in groups]
        self.states, self.group = names[0], SymmetryGroup(simulator.symmetries, *names)
        seeds = spawn(0, SCENARIOS)
        self.scenarios = simulator.sample_scenarios(seeds)
        self.actions = simulator.plan(self.scenarios, seeds)
        self.calm = simulator.rollout(self.scenarios.s0, self.actions).states
        scale = self.calm.astype(np.float64).std(axis=(0, 1))
        self.scale = np.where(scale < 1e-6, 1.0, scale)
        self.sensitive = self._sensitive()
        self.noisy = self._noisy(self.scenarios.s0, self.actions, 1)

    def run(self, kind: _Kind) -> SymmetryCheck:
        """Check one kind of transformation."""
        transformed = self.group.transformations(
            self.scenarios.s0, kind.angle, kind.mirrored, kind.shift
        )
        s0, actions = self._apply(transformed)
        expected = _precise(transformed.states(self.calm.astype(np.float64)))
        found = self.simulator.rollout(s0, actions).states
        difference = np.abs(found.astype(np.float64) - expected) / self.scale
        left_out = self.sensitive | self._happened(kind.broken_by, self.calm, found)
        if left_out.all():
            raise CheckFailed(
                f"{self.subject}: {kind.name}: all {SCENARIOS} scenarios are left out, since "
                "rounding changes them or an event of `broken_by` happens; give a shorter horizon"
            )
        wrong = ~left_out & (difference > TOLERANCE).any(axis=(1, 2))
        if wrong.any():
            raise CheckFailed(self._fault(kind, difference, wrong, found))
        self._check_goal(kind, transformed, found, left_out)
        self._check_noise(kind, transformed, left_out)
        largest = float(difference[~left_out].max())
        return SymmetryCheck(kind.name, SCENARIOS, int(left_out.sum()), largest)

    def _apply(self, transformed: Transformations) -> tuple[Floats, Floats]:
        """The transformed start and actions of all scenarios."""
        actions = _precise(transformed.actions(self.actions.astype(np.float64)))
        return _precise(transformed.states(self.scenarios.s0.astype(np.float64))), actions

    def _sensitive(self) -> Booleans:
        """Which rollouts change by rounding alone."""
        generator, s0 = np.random.default_rng(0), self.scenarios.s0
        changed = np.zeros(SCENARIOS, bool)
        for _ in range(NUDGES):
            factor = 1 + ROUNDING * generator.choice([-1.0, 1.0], s0.shape)
            nudged = self.simulator.rollout((s0 * factor).astype(np.float32), self.actions).states
            change = np.abs(nudged.astype(np.float64) - self.calm) / self.scale
            changed |= (change > TOLERANCE).any(axis=(1, 2))
        return changed

    def _happened(self, events: Names, *both: Floats) -> Booleans:
        """Whether one of the events happens in a rollout [N, T+1, D] or in the transformed one."""
        happened = np.zeros(len(both[0]), bool)
        for rollouts in both:
            by_name = self.simulator.events(rollouts)
            for name in events:
                if name not in by_name:
                    raise CheckFailed(
                        f"{self.subject}: turn.broken_by names the event '{name}', which "
                        f"`events` does not return; it returns {list(by_name)}"
                    )
                happened |= by_name[name]
        return happened

    def _fault(self, kind: _Kind, difference: Doubles, wrong: Booleans, found: Floats) -> str:
        """Name the component that differs first, and an event that explains it."""
        beyond = np.where(wrong[:, None, None], difference, 0.0)
        step = int((beyond > TOLERANCE).any(axis=(0, 2)).argmax())
        column = int(beyond[:, step].max(axis=0).argmax())
        text = (
            f"{self.subject}: {kind.name}: '{self.states[column]}' at step {step} differs by "
            f"{beyond[:, step, column].max():.2g} standard deviations from the rollout of the "
            f"transformed start and actions, in {wrong.sum()} of {SCENARIOS} scenarios"
        )
        names = self.simulator.events(self.calm)
        event = next(
            (name for name in names if self._happened((name,), self.calm, found)[wrong].all()), None
        )
        if event is not None and 2 * wrong.sum() < SCENARIOS:
            return f"{text}, in all of which '{event}' happens; name the event in turn.broken_by"
        return f"{text}; declare how this variable and the actions transform"

    def _check_goal(
        self, kind: _Kind, transformed: Transformations, states: Floats, left_out: Booleans
    ) -> None:
        """The distance from `position` to `target` does not change."""
        goal = _precise(transformed.goal(self.scenarios.goal.astype(np.float64)))
        before = self._distance(self.calm, self.scenarios.goal)
        change = np.abs(self._distance(states, goal) - before)[~left_out].max()
        if change > TOLERANCE * before.std():
            names = ", ".join(f"'{variable.name}'" for variable in self.simulator.goal)
            raise CheckFailed(
                f"{self.subject}: {kind.name}: the distance to the target changes by "
                f"{change:.2g} m; declare how the goal transforms ({names})"
            )

    def _distance(self, states: Floats, goal: Floats) -> Doubles:
        """Metres from the position to the target, [N, T+1]."""
        simulator = self.simulator
        difference = simulator.position(states) - simulator.target(goal)[:, None]
        return np.asarray(np.linalg.norm(difference.astype(np.float64), axis=-1))

    def _noisy(self, s0: Floats, actions: Floats, seed: int) -> Floats:
        """Noisy rollouts of the first scenarios, [`NOISY_SCENARIOS` · `ROLLOUTS`, T+1, D]."""
        seeds = spawn(seed, NOISY_SCENARIOS * ROLLOUTS)
        s0, actions = (
            values[:NOISY_SCENARIOS].repeat(ROLLOUTS, axis=0) for values in (s0, actions)
        )
        return self.simulator.rollout(s0, actions, seeds).states

    def _check_noise(self, kind: _Kind, transformed: Transformations, left_out: Booleans) -> None:
        """Transformed noisy rollouts have the distribution of those of the transformed start.

        Both samples of a scenario are standardised together, and the scenarios are pooled
        (Kolmogorov-Smirnov test of each component, at the middle and at the end).
        """
        found = self._noisy(*self._apply(transformed), 2)
        shape, maps = (NOISY_SCENARIOS, ROLLOUTS, *found.shape[1:]), transformed.states
        first = AffineMaps(maps.matrix[:NOISY_SCENARIOS], maps.offset[:NOISY_SCENARIOS])
        expected = first(self.noisy.reshape(shape).astype(np.float64))
        broken = self._happened(kind.broken_by, self.noisy, found).reshape(shape[:2]).any(axis=1)
        included = ~(broken | left_out[:NOISY_SCENARIOS])
        expected, found = expected[included], found.reshape(shape)[included]
        if not included.any():
            return
        horizon = shape[2] - 1
        for step in sorted({(horizon + 1) // 2, horizon}):
            samples = np.stack([expected[:, :, step], found[:, :, step]], axis=1)
            deviation = samples - samples.mean(axis=(1, 2), keepdims=True)
            std = deviation.std(axis=(1, 2), keepdims=True)
            deviation /= np.where(std < TOLERANCE * self.scale, np.inf, std)
            for column, name in enumerate(self.states):
                one, other = deviation[:, 0, :, column].ravel(), deviation[:, 1, :, column].ravel()
                if ks_2samp(one, other, method="asymp").pvalue < LEVEL:
                    raise CheckFailed(
                        f"{self.subject}: {kind.name}: '{name}' at step {step} has another "
                        "distribution in noisy rollouts than in those of the transformed start; "
                        "the noise does not have this symmetry"
                    )


def _precise(values: Doubles) -> Floats:
    """Transformed in double precision and rounded once."""
    return values.astype(np.float32)
