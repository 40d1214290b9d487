"""Check that a simulator does what the study relies on, in the manner of Gymnasium's `check_env`.

::

    import study
    study.check_simulator(MySimulator)
"""

from collections.abc import Iterator
from typing import Any

import mujoco
import numpy as np

from study.common.arrays import Array, Floats
from study.common.contract import (
    CheckFailed,
    call,
    expect_array,
    expect_same,
    preserved_generators,
)
from study.common.registry import full_name
from study.common.seeds import Seeds, spawn
from study.envs.check_symmetries import check_symmetries
from study.envs.registration import check_class
from study.envs.simulator import Episode, Scenarios, Simulator

SCENARIOS = 8
"""Scenarios N that are simulated."""


def check_simulator(simulator: type[Simulator], horizon: int | None = None) -> None:
    """Check a class: attributes, shapes, types, seeds, causality, outcomes, scene and symmetries.

    Args:
        simulator: the class; it need not be registered.
        horizon: control steps T; None is the system's own.

    Raises:
        BadInput: the class lacks an attribute or a method.
        CheckFailed: a method returns something else than the study relies on.
    """
    check_class(simulator)
    with preserved_generators():
        _Check(simulator, horizon).run()


def check_foreign(simulator: type[Simulator], horizon: int | None = None) -> None:
    """`check_simulator`, unless the class is one of the study, which has tests instead."""
    if not simulator.__module__.startswith("study.envs."):
        check_simulator(simulator, horizon)


class _Check:
    """The checks of one class, on N scenarios."""

    def __init__(self, simulator: type[Simulator], horizon: int | None) -> None:
        self.name = full_name(simulator)
        self.simulator: Simulator = call(f"{self.name}.__init__", simulator, horizon)
        for attribute in ("horizon", "threads"):
            if not hasattr(self.simulator, attribute):
                raise CheckFailed(f"{self.name}.__init__ does not call super().__init__")
        self.seeds = spawn(0, SCENARIOS)
        self.sizes = (
            SCENARIOS,
            self.simulator.horizon,
            len(self.simulator.state),
            len(self.simulator.action),
        )

    def run(self) -> None:
        """Run all checks.

        Raises:
            CheckFailed: see the module.
        """
        scenarios = self.scenarios(self.seeds)
        self.policy(scenarios)
        self.episode(scenarios, None, "without seeds")
        self.episode(scenarios, self.seeds, "with seeds")
        actions = self.plan(scenarios)
        results = dict(self.results(np.arange(SCENARIOS), scenarios, actions))
        states = results["rollout.states"]
        expect_same(f"{self.name}.rollout", states[:, 0], scenarios.s0, "for s_0 than it was given")
        self.seeds_alone(scenarios, actions, results)
        self.causality(scenarios, actions, states)
        self.steps(scenarios, actions, states)
        self.outcomes(states, scenarios.goal)
        self.scene(states)
        check_symmetries(self.simulator)

    def scenarios(self, seeds: Seeds) -> Scenarios:
        """`sample_scenarios`."""
        subject, simulator = f"{self.name}.sample_scenarios", self.simulator
        scenarios = call(subject, simulator.sample_scenarios, seeds)
        if not isinstance(scenarios, Scenarios):
            raise CheckFailed(f"{subject} returned a {type(scenarios).__name__}, wanted Scenarios")
        expect_array(f"{subject} (s0)", scenarios.s0, (len(seeds), self.sizes[2]))
        expect_array(f"{subject} (goal)", scenarios.goal, (len(seeds), len(simulator.goal)))
        return scenarios

    def policy(self, scenarios: Scenarios) -> None:
        """`policy`, and its first actions."""
        subject = f"{self.name}.policy"
        policy = call(subject, self.simulator.policy, scenarios, self.seeds)
        if not callable(policy):
            raise CheckFailed(
                f"{subject} returned {policy!r:.40}, wanted a function of t and states"
            )
        actions = call(f"{subject}(…)", policy, 0, scenarios.s0)
        expect_array(f"{subject}(…)", actions, (SCENARIOS, self.sizes[3]), None)

    def episode(self, scenarios: Scenarios, seeds: Seeds | None, which: str) -> None:
        """`start_episode`, and its first step."""
        subject, simulator = f"{self.name}.start_episode", self.simulator
        episode = call(subject, simulator.start_episode, scenarios.s0, seeds)
        if not isinstance(episode, Episode):
            raise CheckFailed(f"{subject} returned a {type(episode).__name__}, wanted an Episode")
        subject = full_name(type(episode))
        if not hasattr(episode, "unobserved"):
            raise CheckFailed(f"{subject} has no attribute `unobserved`, wanted an array [N, H]")
        shape = (SCENARIOS, len(simulator.unobserved))
        expect_array(f"{subject}.unobserved ({which})", episode.unobserved, shape)
        middle = np.mean([(v.low, v.high) for v in simulator.action], axis=1).astype(np.float32)
        actions = np.tile(middle, (SCENARIOS, 1))
        states = call(f"{subject}.step", episode.step, actions)
        expect_array(f"{subject}.step ({which})", states, (SCENARIOS, self.sizes[2]))

    def plan(self, scenarios: Scenarios) -> Floats:
        """`plan`."""
        subject, simulator = f"{self.name}.plan", self.simulator
        actions: Floats = call(subject, simulator.plan, scenarios, self.seeds)
        count, horizon, _, size = self.sizes
        expect_array(subject, actions, (count, horizon, size))
        for column, variable in enumerate(simulator.action):
            low, high = actions[..., column].min(), actions[..., column].max()
            if low < np.float32(variable.low) or high > np.float32(variable.high):
                raise CheckFailed(
                    f"{subject} returned '{variable.name}' between {low:g} and {high:g}, "
                    f"wanted it between {variable.low:g} and {variable.high:g}"
                )
        return actions

    def results(
        self, rows: Array, scenarios: Scenarios, actions: Floats
    ) -> Iterator[tuple[str, Array]]:
        """What the seeds of some scenarios give, by method."""
        seeds = self.seeds[rows]
        sampled = self.scenarios(seeds)
        yield "sample_scenarios", np.concatenate([sampled.s0, sampled.goal], axis=1)
        chosen = Scenarios(scenarios.s0[rows], scenarios.goal[rows])
        yield "plan", call(f"{self.name}.plan", self.simulator.plan, chosen, seeds)
        rollout = self.rollout(chosen.s0, actions[rows], seeds)
        yield "rollout.states", rollout.states
        yield "rollout.unobserved", rollout.unobserved

    def rollout(self, s0: Floats, actions: Floats, seeds: Seeds | None) -> Any:
        """`rollout`."""
        subject = f"{self.name}.rollout"
        rollout = call(subject, self.simulator.rollout, s0, actions, seeds)
        _, horizon, size, _ = self.sizes
        expect_array(f"{subject} (states)", rollout.states, (len(s0), horizon + 1, size))
        shape = (len(s0), len(self.simulator.unobserved))
        expect_array(f"{subject} (unobserved)", rollout.unobserved, shape)
        return rollout

    def seeds_alone(self, scenarios: Scenarios, actions: Floats, results: dict[str, Array]) -> None:
        """A scenario's results depend on its own seed, and on nothing else."""
        every = np.arange(SCENARIOS)
        for rows, difference in (
            (every, "when it was called again with the same seeds"),
            (every[2:3], "for a scenario alone than for the same scenario in a batch"),
            (every[::-1], "for the same scenarios in another order"),
        ):
            for method, values in self.results(rows, scenarios, actions):
                expect_same(f"{self.name}.{method}", values, results[method][rows], difference)
        others = self.rollout(scenarios.s0, actions, spawn(1, SCENARIOS))
        if np.array_equal(others.states, results["rollout.states"]):
            raise CheckFailed(
                f"{self.name}.rollout returned the same states for other seeds: "
                "take the noise of a trajectory from its seed"
            )

    def causality(self, scenarios: Scenarios, actions: Floats, states: Floats) -> None:
        """A later action does not change an earlier state."""
        late = self.sizes[1] // 2
        changed = actions.copy()
        bounds = np.array([v.low + v.high for v in self.simulator.action], np.float32)
        changed[:, late:] = bounds - changed[:, late:]
        other = self.rollout(scenarios.s0, changed, self.seeds).states
        difference = f"before step {late} after the actions from there on were changed"
        expect_same(f"{self.name}.rollout", other[:, : late + 1], states[:, : late + 1], difference)

    def steps(self, scenarios: Scenarios, actions: Floats, states: Floats) -> None:
        """An episode that goes step by step, as in Gymnasium, gives what `rollout` gives."""
        episode = self.simulator.start_episode(scenarios.s0, self.seeds, 1)
        stepped = np.stack([episode.step(actions[:, t]) for t in range(self.sizes[1])], axis=1)
        subject = f"{self.name}.start_episode"
        expect_same(subject, stepped, states[:, 1:], "than `rollout` with noise_steps=1")

    def outcomes(self, states: Floats, goal: Floats) -> None:
        """`position`, `target`, `reached`, `outcome`, `outcomes` and `events`."""
        simulator, (count, horizon, _, _) = self.simulator, self.sizes
        for method, argument in (("position", states), ("position", states[0, 0])):
            subject = f"{self.name}.{method}"
            positions = call(subject, simulator.position, argument)
            expect_array(subject, positions, (*argument.shape[:-1], 3), None)
        targets = call(f"{self.name}.target", simulator.target, goal)
        expect_array(f"{self.name}.target", targets, (count, 3), None)
        fan, goals = np.repeat(states[:, None, 1:], 2, axis=1), goal[:, None]
        reached = self._happened("reached", fan, goals, (count, 2, horizon))
        if (reached[..., :-1] & ~reached[..., 1:]).any():
            raise CheckFailed(f"{self.name}.reached returned True and later False in a trajectory")
        outcome = self._happened("outcome", fan, goals, (count, 2))
        outcomes = self._outcomes(fan, goals, (count, 2))
        first = next(iter(outcomes))
        if not np.array_equal(outcomes[first], outcome):
            raise CheckFailed(f"{self.name}.outcomes: the first, '{first}', differs from `outcome`")
        lost = np.full_like(fan, np.nan)
        with np.errstate(invalid="ignore"):
            of_lost = {"reached": self._happened("reached", lost, goals, (count, 2, horizon))}
            of_lost |= self._outcomes(lost, goals, (count, 2))
        for name, happened in of_lost.items():
            if happened.any():
                raise CheckFailed(f"{self.name}: '{name}' is true of states that are not finite")
        for name, happened in call(f"{self.name}.events", simulator.events, states).items():
            expect_array(f"{self.name}.events ('{name}')", happened, (count,), np.bool_)

    def _happened(self, method: str, states: Floats, goal: Floats, shape: tuple[int, ...]) -> Any:
        happened = call(f"{self.name}.{method}", getattr(self.simulator, method), states, goal)
        expect_array(f"{self.name}.{method}", happened, shape, np.bool_)
        return happened

    def _outcomes(self, states: Floats, goal: Floats, shape: tuple[int, ...]) -> dict[str, Any]:
        subject = f"{self.name}.outcomes"
        outcomes = call(subject, self.simulator.outcomes, states, goal)
        if not isinstance(outcomes, dict) or not outcomes:
            raise CheckFailed(f"{subject} returned {outcomes!r:.60}, wanted outcomes by name")
        for name, happened in outcomes.items():
            expect_array(f"{subject} ('{name}')", happened, shape, np.bool_)
        return outcomes

    def scene(self, states: Floats) -> None:
        """`scene` and `configuration`; a system may be without a scene."""
        scene = call(f"{self.name}.scene", self.simulator.scene)
        if scene is None:
            return
        if not isinstance(scene, mujoco.MjModel):
            kind = type(scene).__name__
            raise CheckFailed(f"{self.name}.scene returned a {kind}, wanted an MjModel or None")
        subject = f"{self.name}.configuration"
        qpos = call(subject, self.simulator.configuration, states)
        expect_array(subject, qpos, (*states.shape[:-1], scene.nq), None)
