"""The Gymnasium environments: their contract, and the same dynamics as the batched simulators."""

import subprocess
import sys
import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from study.common.errors import BadInput, StudyError
from study.common.seeds import spawn
from study.envs import gymnasium_id, simulators
from study.envs.card.filmstrip import frames
from study.envs.gymnasium_env import SimulatorEnv
from study.examples import cart
from tests.helpers import bodiless

NAMES = ["pusher", "uav", cart.Cart.name]


def make(name: str, **options: object) -> SimulatorEnv:
    environment = gymnasium.make(gymnasium_id(simulators[name]), **options).unwrapped  # type: ignore[arg-type]
    assert isinstance(environment, SimulatorEnv)
    return environment


def test_the_names() -> None:
    assert gymnasium_id(simulators["pusher"]) == "study/Pusher-v0"
    assert gymnasium_id(simulators["uav"]) == "study/UAV-v0"


def test_a_program_that_knows_only_gymnasium_can_make_them() -> None:
    program = "import gymnasium; print(gymnasium.make('study.envs:study/UAV-v0').reset(seed=0)[1])"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert "success" in done.stdout, done.stderr


def test_importing_the_environments_does_not_import_what_pictures_need() -> None:
    program = "import sys, study.envs; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    modules = done.stdout.split()
    assert "study.envs.pusher" in modules
    assert not {"matplotlib", "study.envs.card", "study.envs.rendering"} & set(modules)


@pytest.mark.parametrize("name", ["pusher", "uav"])
def test_check_env_has_no_complaint(name: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(make(name))


@pytest.mark.parametrize("name", NAMES)
def test_whole_trajectories_are_those_of_the_batched_simulator(name: str) -> None:
    """They have the same numbers, bit for bit."""
    simulator, seeds = simulators[name](), spawn(1, 12)
    scenarios = simulator.sample_scenarios(seeds)
    actions = simulator.plan(scenarios, seeds)
    noise = spawn(2, 12)
    batched = simulator.rollout(scenarios.s0, actions, noise)
    succeeded = simulator.outcome(batched.states[:, 1:], scenarios.goal)
    environment, size = make(name), len(simulator.state)
    for row in (0, 5):
        seeds_of_row = {"scenario": seeds[row], "noise": noise[row]}
        observation, info = environment.reset(options=seeds_of_row)
        states, total = [observation[:size]], 0.0
        for action in actions[row]:
            observation, reward, terminated, truncated, info = environment.step(
                environment.scaled(action)
            )
            assert not terminated
            assert truncated == (len(states) == simulator.horizon)
            states.append(observation[:size])
            total += reward
        np.testing.assert_array_equal(states, batched.states[row])
        np.testing.assert_array_equal(observation[size:], scenarios.goal[row])
        np.testing.assert_array_equal(info["unobserved"], batched.unobserved[row])
        assert total == info["success"] == succeeded[row]


def test_noise_none_is_the_nominal_system() -> None:
    simulator, seeds = simulators["pusher"](), spawn(3, 1)
    scenarios = simulator.sample_scenarios(seeds)
    actions = simulator.plan(scenarios, seeds)
    nominal = simulator.rollout(scenarios.s0, actions).states[0]
    environment = make("pusher")
    environment.reset(options={"scenario": seeds[0], "noise": None})
    states = [environment.step(environment.scaled(action))[0][:12] for action in actions[0]]
    np.testing.assert_array_equal(states, nominal[1:])


@pytest.mark.parametrize("name", NAMES)
def test_a_seed_names_scenario_and_noise(name: str) -> None:
    def play(seed: int) -> np.ndarray:
        environment = make(name)
        first, _ = environment.reset(seed=seed)
        environment.action_space.seed(0)
        steps = [environment.step(environment.action_space.sample())[0] for _ in range(5)]
        return np.stack([first, *steps, environment.reset()[0]])

    one = play(4)
    np.testing.assert_array_equal(one, play(4))
    assert (one != play(5)).any()
    assert (one[0] != one[-1]).any()  # The next episode has another scenario.


@pytest.mark.parametrize("name", ["pusher", "uav"])
def test_actions_are_scaled_to_the_bounds_and_back(name: str) -> None:
    environment = make(name)
    low, high = np.array([(v.low, v.high) for v in environment.simulator.action], np.float32).T
    ones = np.ones(len(low))
    np.testing.assert_array_equal(environment.physical(-ones), low)
    np.testing.assert_array_equal(environment.physical(3 * ones), high)
    actions = np.random.default_rng(0).uniform(low, high, (10_000, len(low))).astype(np.float32)
    scaled = environment.scaled(actions)
    assert np.abs(scaled).max() <= 1
    np.testing.assert_array_equal(environment.physical(scaled), actions)


def test_the_horizon_is_an_argument() -> None:
    environment = make("pusher", horizon=3)
    environment.reset(seed=0)
    ends = [environment.step(np.zeros(2))[3] for _ in range(3)]
    assert ends == [False, False, True]


@pytest.mark.parametrize("action", [[np.nan, 0.0], [0.0, np.inf], [0.0], 0.0, [[0.0, 0.0]]])
def test_an_action_that_is_not_finite_or_has_another_shape_is_refused(action: object) -> None:
    environment = make("pusher")
    before, _ = environment.reset(seed=0)
    with pytest.raises(ValueError, match="action: got"):
        environment.step(action)  # type: ignore[arg-type]
    after = environment.step(np.zeros(2))[0]
    environment.reset(seed=0)
    np.testing.assert_array_equal(after, environment.step(np.zeros(2))[0])
    assert np.isfinite(before).all()


@pytest.mark.parametrize("horizon", [0, -3])
def test_a_horizon_below_one_is_refused(horizon: int) -> None:
    with pytest.raises(BadInput, match=f"got a horizon of {horizon}; it must be at least 1"):
        make("pusher", horizon=horizon)


def test_a_system_without_a_scene_says_that_it_cannot_be_drawn() -> None:
    environment = make(bodiless.Bodiless.name, render_mode="rgb_array")
    environment.reset(seed=0)
    with pytest.raises(StudyError, match="has no MuJoCo scene and cannot be drawn"):
        environment.render()
    with pytest.raises(StudyError, match="has no MuJoCo scene and cannot be drawn"):
        frames(environment.simulator, np.zeros((5, 2), np.float32), np.zeros(1, np.float32))


def test_a_title_may_have_any_characters() -> None:
    assert gymnasium_id(bodiless.Bodiless) == "study/50-_a-b-c-d-v0"


def test_misuse_raises_a_clear_error() -> None:
    environment = make("pusher")
    with pytest.raises(ValueError, match=r"options: got \['scenaro'\]; allowed are"):
        environment.reset(options={"scenaro": 1})
    with pytest.raises(RuntimeError, match="call reset"):
        make("pusher").step(np.zeros(2))
    with pytest.raises(ValueError, match="render_mode"):
        SimulatorEnv("pusher", render_mode="human")
