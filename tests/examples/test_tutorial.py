"""The tutorial: the command of its page runs, and its model learns."""

import re
import shlex
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pandas as pd
import pytest

from study.common.progress import Progress
from study.common.seeds import spawn
from study.data.trajectories import concatenate
from study.envs.observe import observe_scenarios
from study.examples import cart, drift
from study.examples.cart import Cart
from tests.helpers.running import SMOKE, study

PAGE = Path(cart.__file__).with_name("README.md")
SMALL = [
    "--collect.trajectories=40",
    "--collect.scenarios=8",
    "--grid.levels=[low]",
    "--engine.kind=serial",
]


@pytest.mark.slow
def test_the_command_of_the_page_runs(tmp_path: Path) -> None:
    command = re.search(r"^python -m study\.run (all .*?[^\\])$", PAGE.read_text(), re.M | re.S)
    assert command is not None
    name, *flags = shlex.split(command[1].replace("\\\n", ""))
    # The command's flags override the configuration, and the flags here override both.
    done = study(name, *SMOKE, *flags, *SMALL, "--out", tmp_path)
    assert done.code == 0, done
    scores = pd.read_parquet(tmp_path / "scores.parquet")
    assert set(scores.environment) == {"cart"}
    assert {"drift", "probabilistic_mlp", "oracle"} <= set(scores.model)


@pytest.mark.slow
def test_the_steps_from_a_copy_to_a_scored_cell(tmp_path: Path) -> None:
    """In a folder of one's own, in other processes, with the worker processes of Dask."""
    steps = "".join(re.findall(r"^```bash\n(.*?)^```", PAGE.read_text(), re.M | re.S))
    small = [flag for flag in SMALL if "kind" not in flag] + ["--engine.workers=1"]
    script = (
        steps.replace("study/examples/", f"{PAGE.parent}/")
        .replace("python ", f"{shlex.quote(sys.executable)} ")
        .replace("all --name", f"all {shlex.join(SMOKE)} --name")
        .replace("--collect.trajectories 500", shlex.join(small))
    )
    done = subprocess.run(
        ["bash", "-e", "-c", script], cwd=tmp_path, capture_output=True, text=True
    )
    assert done.returncode == 0, done
    assert done.stderr == ""
    assert re.match(r"\d+ stages to run", done.stdout), "the two checks print nothing"
    scores = pd.read_parquet(tmp_path / "mine" / "results" / "mine" / "scores.parquet")
    assert set(scores.environment) == {"my_cart"}
    assert {"my_drift", "probabilistic_mlp", "oracle"} <= set(scores.model)


@pytest.mark.parametrize("module", [cart, drift])
def test_a_file_of_the_tutorial_is_short(module: ModuleType) -> None:
    assert module.__file__ is not None
    assert len(Path(module.__file__).read_text().splitlines()) < 100


def test_the_outcome_of_the_cart_is_uncertain() -> None:
    scenarios = concatenate(observe_scenarios(Cart(), 60, 20, 0, Progress()))
    probability = Cart().outcome(scenarios.observed, scenarios.goal[:, None]).mean(axis=1)
    assert 0.2 < probability.mean() < 0.8
    assert ((probability > 0.1) & (probability < 0.9)).mean() > 0.1


def test_the_mass_resists_the_force() -> None:
    simulator, count = Cart(), 200
    s0, actions = np.zeros((count, 2), np.float32), np.ones((count, 20, 1), np.float32)
    rollout = simulator.rollout(s0, actions, spawn(0, count))
    impulse = rollout.states[:, -1, 1] * rollout.unobserved[:, 0]
    noise = 0.2 * simulator.control_step * np.sqrt(20)
    assert impulse.mean() == pytest.approx(2.0, abs=4 * noise / np.sqrt(count))
    assert impulse.std() == pytest.approx(noise, rel=0.2)
