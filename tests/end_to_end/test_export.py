"""A data set written in Minari's format by the command line, and read with Minari."""

import json
import subprocess
import sys
from pathlib import Path

import gymnasium
import minari
import numpy as np
import pytest

from study.common.files import sha256
from study.common.progress import Progress
from study.config.stage_settings import CollectSettings
from study.data import minari as export
from study.data.trajectories import Trajectories
from study.envs.gymnasium_env import SimulatorEnv
from study.examples.cart import Cart
from study.stages import collect
from tests.helpers.running import ROOT, SMOKE, configuration, study

ID = f"study/cart/smoke-v{Cart.version}"
CART = [*SMOKE, "--plugins=[study.examples.cart]", "--collect.horizon=30"]


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of Minari data sets that holds the cart's training data."""
    folder = tmp_path_factory.mktemp("minari") / "data sets"
    done = study("export", "cart", *CART, "--to", folder)
    assert done.code == 0, done
    assert f'minari.load_dataset("{ID}")' in done.out
    return folder


@pytest.fixture
def dataset(root: Path, monkeypatch: pytest.MonkeyPatch) -> minari.MinariDataset:
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(root))
    return minari.load_dataset(ID)


@pytest.fixture(scope="module")
def trajectories(tmp_path_factory: pytest.TempPathFactory) -> Trajectories:
    """What the study would train on."""
    out = tmp_path_factory.mktemp("collected")
    settings = CollectSettings("cart", configuration(*CART).collect)
    collect.run(settings, {}, out, Progress())
    return Trajectories.load(out / "train.safetensors")


def recovered(dataset: minari.MinariDataset) -> SimulatorEnv:
    environment = dataset.recover_environment().unwrapped
    assert isinstance(environment, SimulatorEnv)
    return environment


def test_it_holds_what_the_study_trains_on(
    dataset: minari.MinariDataset, trajectories: Trajectories
) -> None:
    environment = recovered(dataset)
    assert dataset.total_episodes == len(trajectories) == 40
    assert dataset.total_steps == 40 * 30
    for row, episode in enumerate(dataset):
        states, goal = np.split(episode.observations, [len(Cart.state)], axis=-1)
        assert episode.observations.dtype == np.float32
        np.testing.assert_array_equal(states, trajectories.states[row])
        np.testing.assert_array_equal(goal, np.tile(trajectories.goal[row], (31, 1)))
        actions = environment.physical(episode.actions)
        np.testing.assert_array_equal(actions, trajectories.actions[row])
    unobserved = [about["unobserved"] for about in dataset.storage.get_episode_metadata(range(40))]
    np.testing.assert_array_equal(unobserved, trajectories.unobserved)


def test_stepping_the_recovered_environment_gives_every_episode_again(
    dataset: minari.MinariDataset,
) -> None:
    environment = dataset.recover_environment()
    returns = []
    for episode, about in zip(
        dataset, dataset.storage.get_episode_metadata(range(len(dataset))), strict=True
    ):
        observation, info = environment.reset(options=about["options"])
        np.testing.assert_array_equal(info["unobserved"], about["unobserved"])
        observations, steps = [observation], []
        for action in episode.actions:
            observation, *step, info = environment.step(action)
            observations.append(observation)
            steps.append(step)
        np.testing.assert_array_equal(observations, episode.observations)
        rewards, terminations, truncations = zip(*steps, strict=True)
        np.testing.assert_array_equal(rewards, episode.rewards)
        np.testing.assert_array_equal(terminations, episode.terminations)
        np.testing.assert_array_equal(truncations, episode.truncations)
        assert episode.rewards.sum() == info["success"]
        returns.append(episode.rewards.sum())
    assert 0 < np.mean(returns) < 1  # both ends were seen


def test_the_spaces_are_those_of_the_environment(dataset: minari.MinariDataset) -> None:
    environment = gymnasium.make("study/Cart-v0", horizon=30)
    assert dataset.observation_space == environment.observation_space
    assert dataset.action_space == environment.action_space
    assert dataset.env_spec == environment.spec
    episode = dataset[0]
    assert all(o in dataset.observation_space for o in episode.observations)
    assert all(a in dataset.action_space for a in episode.actions)


def test_names_units_seeds_versions_and_checksum(
    dataset: minari.MinariDataset, root: Path, trajectories: Trajectories
) -> None:
    about = minari.list_local_datasets()[ID]["study"]
    assert isinstance(about, dict)
    files = about.pop("sha256")
    assert about == trajectories.facts
    assert [(v["name"], v["unit"]) for v in about["state"]] == [("x", "m"), ("v", "m/s")]
    assert about["action"][0]["low"] == -1.0
    assert about["goal"][0]["low"] is None  # JSON has no infinity
    assert {"seed", "environment_version", "control_step"} <= about.keys()
    assert {"mujoco", "numpy", "study"} <= about["versions"].keys()
    assert files == {"main_data.hdf5": sha256(root / ID / "data" / "main_data.hdf5")}


def test_minari_knows_the_folders_as_its_own(dataset: minari.MinariDataset) -> None:
    from minari.namespace import list_local_namespaces

    assert ID in minari.list_local_datasets()
    assert list_local_namespaces() == ["study", "study/cart"]


def test_the_same_bytes_in_the_place_that_minari_takes(
    root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    assert study("export", "cart", *CART).code == 0
    for name in ("main_data.hdf5", "metadata.json"):
        assert sha256(tmp_path / ID / "data" / name) == sha256(root / ID / "data" / name)


def test_a_data_set_that_is_there_is_kept(root: Path) -> None:
    before = sha256(root / ID / "data" / "main_data.hdf5")
    done = study("export", "cart", *CART, "--collect.seed=1", "--to", root)
    assert (done.code, done.out, done.err.count("\n")) == (2, "", 1)
    assert f"{ID} exists; remove it, or use another --name or --to" in done.err
    assert sha256(root / ID / "data" / "main_data.hdf5") == before
    assert study("export", "cart", *CART, "--name=other", "--to", root).code == 0


def test_what_is_interrupted_leaves_no_data_set(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def stop(path: Path) -> str:
        assert path.stat().st_size > 0  # the data are written, the name is not given yet
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(export, "sha256", stop)
        assert study("export", "cart", *CART, "--to", tmp_path).code == 130
    assert not list(tmp_path.rglob("*.hdf5"))
    assert not (tmp_path / ID).exists()
    assert study("export", "cart", *CART, "--to", tmp_path).code == 0


@pytest.mark.parametrize("module", ["minari", "h5py"])
def test_without_minari(module: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    done = study("export", "cart", *CART, "--to", tmp_path)
    assert done.code == 1
    assert done.err == "error: Minari is not installed: pip install -e '.[minari]'\n"
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["export"], "environment"),
        (["export", "pushr"], "did you mean 'pusher'?"),
        (["export", "pusher", "--too", "x"], "unknown setting 'too'"),
        (["export", "pusher", "--to"], "its value is missing"),
        (["export", "pusher", "--name", "a b"], "letters, digits, ., - and _"),
        (["export", "cart", *CART, "--to", "/proc/nowhere"], "--to: cannot write to"),
        (["all", "--to", "x"], "unknown setting 'to'"),
    ],
    ids=lambda value: " ".join(value)[:40],
)
def test_bad_input_gets_one_line(arguments: list[str], expected: str) -> None:
    done = study(*arguments)
    assert done.code == 2
    assert done.err.startswith("error: ")
    assert done.err.count("\n") == 1
    assert expected in done.err


def test_a_program_that_knows_only_minari_can_use_it(tmp_path: Path) -> None:
    small = ["--collect.trajectories=20", "--collect.horizon=3"]
    assert study("export", "pusher", *SMOKE, *small, "--to", tmp_path).code == 0
    program = """
import json, minari
(name,) = minari.list_local_datasets()
environment = minari.load_dataset(name).recover_environment()
simulator = environment.unwrapped.simulator
print(json.dumps([name, simulator.name, simulator.horizon]))
"""
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", program],
        cwd=ROOT,
        env={"MINARI_DATASETS_PATH": str(tmp_path)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.stderr == ""
    assert json.loads(done.stdout)[1:] == ["pusher", 3]
