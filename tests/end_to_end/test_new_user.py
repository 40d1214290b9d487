"""A new user's whole path: write a system and a model, check, run, edit, run, change a setting."""

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from study import examples
from study.commands.settings import CONFIGS
from study.common.files import read_json
from tests.helpers.running import Done

pytestmark = pytest.mark.slow

SYSTEM = (Path(examples.__file__).parent / "cart.py").read_text(encoding="utf-8")
SYSTEM = SYSTEM.replace('"cart", "Cart"', '"sledge", "Sledge"').replace('("cart")', '("sledge")')
MODEL = """
from dataclasses import dataclass
import torch
from torch import nn
from study.config.sections import setting
from study.config.settings import Train
from study.models import Model, models

@dataclass(frozen=True)
class Settings:
    train: Train
    size: int = setting(4, low=1)

@models.register("glide")
class Glide(Model):
    "Each step adds what a small network makes of the state and the action."

    settings_class = Settings

    def __init__(self, normalization, settings):
        super().__init__(normalization, settings)
        self.noise_size = self.state_size
        layers = nn.Linear(self.state_size + self.action_size, settings.size), nn.Tanh()
        self.step = nn.Sequential(*layers, nn.Linear(settings.size, self.state_size))
        self.std = nn.Parameter(torch.full((self.state_size,), 0.1))

    def losses(self, batch, step):
        states = batch["states"]
        change = self.step(torch.cat([states[:, :-1], batch["actions"]], -1))
        error = states[:, 1:] - states[:, :-1] - change
        return {"loss": (error.square() / self.std.square() + 2 * self.std.log().abs()).mean()}

    def sample(self, s0, actions, noise, member):
        count = noise.shape[1]
        state = s0[:, None].expand(-1, count, -1)
        actions = actions[:, None].expand(-1, count, -1, -1)
        states = []
        for t in range(actions.shape[2]):
            change = self.step(torch.cat([state, actions[:, :, t]], -1))
            state = state + change + self.std * noise[:, :, t]
            states.append(state)
        return torch.stack(states, dim=2)
"""
SETTINGS = """
name: mine
plugins: [my_system, my_model]
grid: {environments: [sledge], models: [glide], levels: {some: 0.5}}
engine: {kind: serial}
"""
CHECK = """
from study import check_model, check_simulator
from my_model import Glide
from my_system import Cart
check_simulator(Cart)
check_model(Glide)
"""
CELL = "sledge/some/glide/seed-0"
MODELS = {f"{stage} {CELL}" for stage in ("train", "evaluate", "record")}


@pytest.fixture
def user(tmp_path: Path) -> Callable[..., Done]:
    """Runs Python in the user's own folder, with the user's own modules."""
    (tmp_path / "my_system.py").write_text(SYSTEM)
    (tmp_path / "my_model.py").write_text(MODEL)
    toy = (CONFIGS / "smoke.yaml").read_text(encoding="utf-8").partition("collect:")
    (tmp_path / "mine.yaml").write_text(SETTINGS + "".join(toy[1:]), encoding="utf-8")

    def run(*arguments: object) -> Done:
        program = [sys.executable, *map(str, arguments)]
        done = subprocess.run(program, cwd=tmp_path, capture_output=True, encoding="utf-8")
        return Done(done.returncode, done.stdout, done.stderr)

    return run


def test_the_whole_path(user: Callable[..., Done], tmp_path: Path) -> None:
    def study(command: str, *arguments: object) -> Done:
        return user("-m", "study.run", command, *arguments)

    def edit(name: str, old: str, new: str) -> None:
        text = (tmp_path / name).read_text()
        assert text.count(old) == 1
        (tmp_path / name).write_text(text.replace(old, new))

    def due(*flags: str) -> dict[str, str]:
        done = study("plan", "--out", out, *flags)
        assert (done.code, done.err) == (0, "")
        return done.due()

    out = tmp_path / "results" / "mine"

    checked = user("-c", CHECK)
    assert (checked.code, checked.out, checked.err) == (0, "", "")
    edit("my_model.py", "torch.stack(states, dim=2)", "torch.stack(states, dim=2)[..., :1]")
    wrong = user("-c", CHECK)
    assert "my_model.Glide.sample returned [" in wrong.err.splitlines()[-1]
    edit("my_model.py", "dim=2)[..., :1]", "dim=2)")

    done = study("all", "--config", "mine.yaml")
    assert (done.code, done.err) == (0, "")
    assert f"\n {CELL}" in done.out
    assert (out / "claims.md").read_text().splitlines()[2].startswith("The paper says nothing")
    assert read_json(out / "claims.json") == []
    assert study("verify", out).code == 0

    edit("my_model.py", "states = []", "states = []  # of each time step")
    assert due() == {}
    edit("my_model.py", "2 * self.std.log()", "self.std.log()")
    changed = due()
    assert set(changed) == MODELS
    assert changed[f"train {CELL}"] == "source changed: my_model"
    note = f"{out}: the source has changed since these were made: my_model; scores may differ"
    forecast = ("forecast", "--cell", CELL, "--scenario", 3, "--save", "a.rrd", "--out", out)
    assert note in study(*forecast).out
    assert "the source has changed since these were made: my_model" in study("verify", out).out
    assert study("all", "--out", out).code == 0
    assert note not in study(*forecast).out

    edit("my_system.py", "0.2 * generator.normal()", "0.3 * generator.normal()")
    changed = due()
    assert changed["collect sledge"] == "source changed: my_system"
    assert len(changed) == 10
    assert study("all", "--out", out).code == 0

    assert (
        due("--model.glide.size=8")[f"train {CELL}"] == "config changed: model_settings.size 4 → 8"
    )
    assert set(due("--model.glide.size=8")) == MODELS
    refused = study("plan", "--out", out, "--model.glide.sice=8")
    assert (refused.code, refused.out) == (2, "")
    assert "did you mean 'model.glide.size'?" in refused.err
    assert study("all", "--out", out, "--model.glide.size=8").code == 0
    assert read_json(out / "study.json")["settings"]["model"]["glide"]["size"] == 8
    assert due() == {}

    verified = study("verify", out, "--rerun", CELL)
    assert verified.code == 0, verified
    assert "all the same numbers" in verified.out
    assert "source" not in verified.out
    done = study(*forecast)
    assert (done.code, done.err) == (0, "")
    assert "reaches the target" in done.out
    shown = study("portrait", "--out", out)
    assert (shown.code, shown.err) == (0, ""), shown
    page = (out / "environments" / "README.md").read_text()
    assert "import my_system  # registers its environment" in page
    assert 'gymnasium.make("study/Sledge-v0"' in page
    assert "tests/envs" not in page
