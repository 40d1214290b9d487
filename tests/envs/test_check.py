"""`check_simulator`: each fault of a system is found and named in one line."""

import random
import re
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
import pytest

import study
from study.common.arrays import Booleans, Doubles, Floats
from study.common.contract import CheckFailed
from study.common.seeds import Seeds
from study.envs import Episode, Policy, Rollout, Scenarios, Simulator
from study.envs.check import check_simulator
from study.examples.cart import Cart, CartEpisode


def broken(method: str, function: Callable[..., Any]) -> type[Simulator]:
    """The cart with another method."""
    return type("Broken", (Cart,), {method: function})


def float64(self: Cart, seeds: Seeds) -> Scenarios:
    scenarios = Cart.sample_scenarios(self, seeds)
    return Scenarios(scenarios.s0.astype(np.float64), scenarios.goal)


def a_global_generator(self: Cart, seeds: Seeds) -> Scenarios:
    scenarios = Cart.sample_scenarios(self, seeds)
    return Scenarios(scenarios.s0 + np.float32(random.random()), scenarios.goal)


def numpys_generator(self: Cart, seeds: Seeds) -> Scenarios:
    noise = np.random.normal(size=(len(seeds), 1)).astype(np.float32)  # noqa: NPY002
    return Scenarios(Cart.sample_scenarios(self, seeds).s0, noise)


def an_own_generator(self: Cart, seeds: Seeds) -> Scenarios:
    noise = np.random.default_rng().normal(size=(len(seeds), 1)).astype(np.float32)
    return Scenarios(Cart.sample_scenarios(self, seeds).s0, noise)


def the_batchs_generator(self: Cart, seeds: Seeds) -> Scenarios:
    noise = np.random.default_rng(0).normal(size=(len(seeds), 1)).astype(np.float32)
    return Scenarios(Cart.sample_scenarios(self, seeds).s0, noise)


def one_force_for_all(self: Cart, scenarios: Scenarios, seeds: Seeds) -> Policy:
    return lambda t, states: np.float32(0.1) * scenarios.goal[:1]


def an_error(self: Cart, s0: Floats, actions: Floats, seeds: Seeds | None = None) -> Rollout:
    raise ValueError("no such force")


def foresight(self: Cart, s0: Floats, actions: Floats, seeds: Seeds | None = None) -> Rollout:
    rollout = Cart.rollout(self, s0, actions, seeds)
    rollout.states[:, 1:] += actions[:, -1:]
    return rollout


def no_noise(self: Cart, s0: Floats, actions: Floats, seeds: Seeds | None = None) -> Rollout:
    return Cart.rollout(self, s0, actions)


def in_place(self: Cart, s0: Floats, actions: Floats, seeds: Seeds | None = None) -> Rollout:
    rollout = Cart.rollout(self, s0, actions, seeds)
    actions *= 2
    return rollout


def lost(self: Cart, s0: Floats, actions: Floats, seeds: Seeds | None = None) -> Rollout:
    rollout = Cart.rollout(self, s0, actions, seeds)
    rollout.states[3, 5, 1] = np.nan
    return rollout


def own_noise(self: Cart, s0: Floats, actions: Floats, seeds: Seeds | None = None) -> Rollout:
    """A rollout that is not that of the episodes."""
    return Cart.rollout(self, s0, actions, None if seeds is None else seeds + np.uint64(1))


class NarrowEpisode(CartEpisode):
    def step(self, actions: Floats) -> Floats:
        return super().step(actions)[:, :1]


def narrow(self: Cart, s0: Floats, seeds: Seeds | None = None, noise_steps: int = 1) -> Episode:
    return NarrowEpisode(s0, seeds, self.control_step)


def flickers(self: Cart, states: Floats, goal: Floats) -> Booleans:
    return np.asarray(np.sin(1e5 * states[..., 0]) > 0)


def true_of_the_lost(self: Cart, states: Floats, goal: Floats) -> dict[str, Booleans]:
    is_reached = Cart.outcome(self, states, goal)
    return {
        "reaches the target": is_reached,
        "stays slow": np.asarray(~(states[..., 1] > 9).any(-1)),
    }


def no_file(self: Cart) -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_path("nowhere.xml")


def wide(self: Cart, states: Floats) -> Doubles:
    return states.astype(np.float64)


FAULTS = [
    ("sample_scenarios", float64, r"sample_scenarios \(s0\) returned float64, wanted float32"),
    (
        "sample_scenarios",
        lambda self, seeds: (np.zeros((8, 2)), np.zeros((8, 1))),
        "sample_scenarios returned a tuple, wanted Scenarios",
    ),
    (
        "sample_scenarios",
        a_global_generator,
        "sample_scenarios used the global random generator of Python; take every random number",
    ),
    (
        "sample_scenarios",
        numpys_generator,
        "sample_scenarios used the global random generator of NumPy; take every random number",
    ),
    (
        "sample_scenarios",
        an_own_generator,
        "sample_scenarios returned other numbers when it was called again with the same seeds",
    ),
    (
        "sample_scenarios",
        the_batchs_generator,
        "sample_scenarios returned other numbers for a scenario alone than",
    ),
    ("policy", one_force_for_all, r"policy\(…\) returned \[1, 1\], wanted \[8, 1\]"),
    ("rollout", an_error, r"rollout raised ValueError: no such force \(.*test_check.py, line"),
    ("rollout", foresight, "rollout returned other numbers before step 10 after the actions"),
    ("rollout", no_noise, "rollout returned the same states for other seeds"),
    ("rollout", in_place, "rollout changed its argument 2 in place; copy it first"),
    ("rollout", lost, r"rollout \(states\) returned nan at \[3, 5, 1\] \(1 of 336 values"),
    ("rollout", own_noise, "start_episode returned other numbers than `rollout`"),
    ("start_episode", narrow, r"step \(without seeds\) returned \[8, 1\], wanted \[8, 2\]"),
    ("position", lambda self, states: states, r"position returned \[8, 21, 2\], wanted .* 3\]"),
    ("target", lambda self, goal: goal, r"target returned \[8, 1\], wanted \[8, 3\]"),
    ("reached", flickers, "reached returned True and later False in a trajectory"),
    ("outcomes", true_of_the_lost, "'stays slow' is true of states that are not finite"),
    ("outcomes", lambda *_: {}, "outcomes returned {}, wanted outcomes by name"),
    ("scene", no_file, "scene raised ValueError: .*nowhere.xml"),
    ("scene", lambda self: "cart.xml", "scene returned a str, wanted an MjModel or None"),
    ("configuration", wide, r"configuration returned \[8, 21, 2\], wanted \[8, 21, 1\]"),
    ("__init__", lambda self, horizon, threads=1: None, "__init__ does not call super"),
]


@pytest.mark.parametrize(("method", "function", "error"), FAULTS)
def test_a_fault_is_named(method: str, function: Callable[..., Any], error: str) -> None:
    with pytest.raises(CheckFailed) as caught:
        check_simulator(broken(method, function))
    line = str(caught.value)
    assert re.search(error, line), line
    assert "\n" not in line


@pytest.mark.parametrize("horizon", [None, 1, 7])
def test_the_cart_has_no_fault(horizon: int | None) -> None:
    study.check_simulator(Cart, horizon)


def test_a_system_needs_no_scene() -> None:
    check_simulator(broken("scene", lambda self: None))


def test_the_global_generators_are_left_as_they_are() -> None:
    random.seed(3)
    np.random.seed(3)  # noqa: NPY002
    expected = random.random(), np.random.normal()  # noqa: NPY002
    random.seed(3)
    np.random.seed(3)  # noqa: NPY002
    check_simulator(Cart)
    assert (random.random(), np.random.normal()) == expected  # noqa: NPY002
