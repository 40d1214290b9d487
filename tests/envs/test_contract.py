"""What holds for every environment: shapes, bounds, seeds and episodes."""

from dataclasses import dataclass

import numpy as np
import pytest

from study.common.arrays import Floats
from study.common.seeds import Seeds, spawn
from study.envs import Rollout, Scenarios, Simulator, simulators
from study.examples import cart

assert cart.Cart.name == "cart"
COUNT = 43  # Not a multiple of any swarm's size.


@dataclass(frozen=True)
class World:
    """An environment with planned and executed scenarios."""

    simulator: Simulator
    seeds: Seeds
    scenarios: Scenarios
    actions: Floats
    noisy: Rollout


@pytest.fixture(scope="module", params=["pusher", "uav", "cart"])
def world(request: pytest.FixtureRequest) -> World:
    simulator, seeds = simulators[request.param](), spawn(7, COUNT)
    scenarios = simulator.sample_scenarios(seeds)
    if request.param == "uav":
        scenarios.s0[3, 2] = 1.0  # It crashes.
        scenarios.s0[5, 16] = 0.05  # Its battery becomes empty.
    actions = simulator.plan(scenarios, seeds)
    return World(
        simulator, seeds, scenarios, actions, simulator.rollout(scenarios.s0, actions, seeds)
    )


def test_arrays_have_the_sizes_of_the_tables(world: World) -> None:
    simulator, horizon = world.simulator, world.simulator.default_horizon
    tables = (simulator.state, simulator.action, simulator.goal, simulator.unobserved)
    d, a, g, h = map(len, tables)
    assert world.noisy.states.shape == (COUNT, horizon + 1, d)
    assert world.actions.shape == (COUNT, horizon, a)
    assert world.scenarios.goal.shape == (COUNT, g)
    assert world.noisy.unobserved.shape == (COUNT, h)
    for array in (world.scenarios.s0, world.scenarios.goal, world.actions):
        assert array.dtype == np.float32
    assert world.noisy.states.dtype == world.noisy.unobserved.dtype == np.float32
    for table in tables:
        assert len({variable.name for variable in table}) == len(table)


def test_numbers_lie_within_the_bounds_of_the_tables(world: World) -> None:
    simulator = world.simulator
    tables = (simulator.state, simulator.action, simulator.goal, simulator.unobserved)
    arrays = (world.noisy.states, world.actions, world.scenarios.goal, world.noisy.unobserved)
    for table, array in zip(tables, arrays, strict=True):
        for column, variable in enumerate(table):
            assert array[..., column].min() >= np.float32(variable.low), variable
            assert array[..., column].max() <= np.float32(variable.high), variable


def test_no_actions_drive_the_state_out_of_its_bounds(world: World) -> None:
    simulator = world.simulator
    low, high = np.array([(v.low, v.high) for v in simulator.action]).T
    generator = np.random.default_rng(0)
    wild = generator.uniform(low, high, (COUNT, simulator.horizon, len(low)))
    wild[::3] = np.where(wild[::3, :1] > 0, high, low)  # full power, one way
    states = simulator.rollout(world.scenarios.s0, wild.astype(np.float32), world.seeds).states
    for column, variable in enumerate(simulator.state):
        assert states[..., column].min() >= np.float32(variable.low), variable
        assert states[..., column].max() <= np.float32(variable.high), variable


@pytest.mark.parametrize("horizon", [1, 7, 65])
def test_any_horizon(world: World, horizon: int) -> None:
    simulator = simulators[world.simulator.name](horizon)
    scenarios = simulator.sample_scenarios(world.seeds[:3])
    actions = simulator.plan(scenarios, world.seeds[:3])
    states = simulator.rollout(scenarios.s0, actions, world.seeds[:3]).states
    assert actions.shape[:2] == (3, horizon)
    assert states.shape[:2] == (3, horizon + 1)
    assert np.isfinite(states).all()


def test_a_rollout_begins_at_s0_and_a_shorter_one_is_its_beginning(world: World) -> None:
    s0, actions = world.scenarios.s0[:9], world.actions[:9, :8]
    short = world.simulator.rollout(s0, actions, world.seeds[:9]).states
    np.testing.assert_array_equal(short, world.noisy.states[:9, :9])
    np.testing.assert_array_equal(world.noisy.states[:, 0], world.scenarios.s0)
    middle = world.noisy.states[:9, 10]
    resumed = world.simulator.rollout(middle, actions, world.seeds[:9]).states
    np.testing.assert_array_equal(resumed[:, 0], middle)


@pytest.mark.parametrize(
    ("rows", "threads", "chunk_size"),
    [
        (np.arange(1), 1, 2048),
        (np.arange(5, 22), 1, 2048),
        (np.arange(COUNT)[::-1], 1, 2048),
        (np.arange(COUNT), 2, 2048),
        (np.arange(COUNT), 1, 10),
        (np.random.default_rng(0).permutation(COUNT)[:23], 3, 7),
    ],
    ids=[
        "alone",
        "17",
        "reversed",
        "2 threads",
        "chunks of 10",
        "shuffled, 3 threads, chunks of 7",
    ],
)
def test_a_trajectory_depends_on_its_own_seed_alone(
    world: World,
    rows: np.ndarray,
    threads: int,
    chunk_size: int,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    simulator = simulators[world.simulator.name](threads=threads)
    monkeypatch.setattr(type(simulator), "chunk_size", chunk_size)
    sampled = simulator.sample_scenarios(world.seeds[rows])
    expected = world.simulator.sample_scenarios(world.seeds)
    np.testing.assert_array_equal(sampled.s0, expected.s0[rows])
    np.testing.assert_array_equal(sampled.goal, expected.goal[rows])
    scenarios = Scenarios(world.scenarios.s0[rows], world.scenarios.goal[rows])
    planned = simulator.plan(scenarios, world.seeds[rows])
    np.testing.assert_array_equal(planned, world.actions[rows])
    rollout = simulator.rollout(scenarios.s0, world.actions[rows], world.seeds[rows])
    np.testing.assert_array_equal(rollout.states, world.noisy.states[rows])
    np.testing.assert_array_equal(rollout.unobserved, world.noisy.unobserved[rows])


def test_noise_does_not_depend_on_the_steps_sampled_together(world: World) -> None:
    s0, seeds = world.scenarios.s0[:5], world.seeds[:5]
    for noise_steps in (1, 3):
        episode = world.simulator.start_episode(s0, seeds, noise_steps)
        for t in range(7):
            states = episode.step(world.actions[:5, t])
            np.testing.assert_array_equal(states, world.noisy.states[:5, t + 1])


def test_seeds_give_noise_and_no_seeds_the_nominal_system(world: World) -> None:
    s0, simulator = world.scenarios.s0, world.simulator
    other = simulator.rollout(s0, world.actions, spawn(8, COUNT)).states[:, -1]
    assert (other != world.noisy.states[:, -1]).any(axis=1).all()
    nominal = simulator.rollout(s0, world.actions).states
    # The plan was made in closed loop with the nominal system.
    policy, states = simulator.policy(world.scenarios, world.seeds), s0
    episode = simulator.start_episode(s0)
    for t in range(simulator.horizon):
        states = episode.step(simulator.clip_actions(policy(t, states)))
    np.testing.assert_array_equal(states, nominal[:, -1])


def test_actions_are_clipped_to_their_bounds(world: World) -> None:
    low, high = np.array([(v.low, v.high) for v in world.simulator.action], np.float32).T
    wild = np.where(np.arange(5)[:, None] % 2, 10 * low, 10 * high)[None].repeat(3, 0)
    tame = np.where(np.arange(5)[:, None] % 2, low, high)[None].repeat(3, 0)
    s0, seeds = world.scenarios.s0[:3], world.seeds[:3]
    one, other = (world.simulator.rollout(s0, a, seeds).states for a in (wild, tame))
    np.testing.assert_array_equal(one, other)


def test_scenarios_vary(world: World) -> None:
    assert (world.scenarios.goal.std(axis=0) > 0).all()
    assert (world.scenarios.s0.std(axis=0) > 0).any()


def test_events_are_named_and_one_a_trajectory(world: World) -> None:
    for name, happened in world.simulator.events(world.noisy.states).items():
        assert happened.shape == (COUNT,), name
        assert happened.dtype == np.bool_


def test_outcomes_are_named_and_the_goal_comes_first(world: World) -> None:
    states, goal = world.noisy.states[:, 1:], world.scenarios.goal
    found = world.simulator.outcomes(states, goal)
    first = next(iter(found))
    np.testing.assert_array_equal(found[first], world.simulator.outcome(states, goal))
    broken = states.copy()
    broken[:, -1] = np.nan
    fan = np.repeat(states[:, None], 2, axis=1)
    for name, happened in found.items():
        assert happened.shape == (COUNT,), name
        assert happened.dtype == np.bool_
        assert world.simulator.outcomes(fan, goal[:, None])[name].shape == (COUNT, 2)
        if name != first:  # The goal may have been reached before.
            assert not world.simulator.outcomes(broken, goal)[name].any(), name
