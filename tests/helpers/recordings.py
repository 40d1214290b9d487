"""Data to record: a puck that forces push over a table, its forecasts, a search, and scores."""

import os
from typing import ClassVar

import mujoco
import numpy as np
import pandas as pd
import pytest

from study.common.arrays import Doubles, Floats
from study.common.seeds import Seeds, spawn
from study.envs import Episode, Policy, Scenarios, Simulator, Variable
from study.envs.noise import Noise
from study.recording.examples import Example
from study.recording.tuning import Trial
from study.recording.viewer import has_driver

SCENE = """
<mujoco>
  <asset><material name="red" rgba="0.8 0.1 0.1 1"/></asset>
  <worldbody>
    <geom name="floor" type="plane" size="0 0 0.1" rgba="0.85 0.85 0.8 1"/>
    <geom name="wall" type="box" size="0.02 1 0.1" pos="1 0 0.1" rgba="0.4 0.3 0.2 1"/>
    <geom name="ghost" type="box" size="1 1 1" rgba="1 1 1 0"/>
    <body name="puck" pos="0 0 0.05">
      <joint type="slide" axis="1 0 0"/>
      <joint type="slide" axis="0 1 0"/>
      <geom name="disc" type="cylinder" size="0.1 0.05" material="red"/>
      <geom name="knob" type="sphere" size="0.05" pos="0 0 0.08"/>
      <geom name="collision" type="box" size="1 1 1" group="3"/>
      <body name="vane" pos="0 0 0.15" quat="0.7071068 0 0.7071068 0">
        <joint type="hinge" axis="1 0 0"/>
        <geom name="rod" type="capsule" size="0.02" fromto="0 0 0 0 0.3 0"/>
        <geom name="egg" type="ellipsoid" size="0.03 0.05 0.03" pos="0 0.3 0"/>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


class Puck(Simulator):
    """State (x, y, ẋ, ẏ), noisy forces, and the goal to come close to a point."""

    name: ClassVar[str] = "puck"
    title: ClassVar[str] = "Puck"
    version: ClassVar[int] = 1
    state: ClassVar[tuple[Variable, ...]] = (
        Variable("x", "m", "position, east"),
        Variable("y", "m", "position, north"),
        Variable("ẋ", "m/s", "velocity, east"),
        Variable("ẏ", "m/s", "velocity, north"),
    )
    action: ClassVar[tuple[Variable, ...]] = (
        Variable("f_x", "N", "force, east"),
        Variable("f_y", "N", "force, north"),
    )
    goal: ClassVar[tuple[Variable, ...]] = action
    default_horizon: ClassVar[int] = 30
    control_step: ClassVar[float] = 0.1
    radius: ClassVar[float] = 0.25

    def sample_scenarios(self, seeds: Seeds) -> Scenarios:
        s0 = np.zeros((len(seeds), 4), dtype=np.float32)
        return Scenarios(s0, np.full((len(seeds), 2), 0.8, dtype=np.float32))

    def start_episode(
        self, s0: Floats, seeds: Seeds | None = None, noise_steps: int = 1
    ) -> Episode:
        return Slide(self.control_step, s0, seeds)

    def policy(self, scenarios: Scenarios, seeds: Seeds) -> Policy:
        return lambda t, states: scenarios.goal * np.float32(0.15)

    def position(self, states: Floats) -> Floats:
        flat = np.zeros((*states.shape[:-1], 3), dtype=np.float32)
        flat[..., :2] = states[..., :2]
        flat[..., 2] = 0.05
        return flat

    def target(self, goal: Floats) -> Floats:
        return self.position(goal)

    def scene(self) -> mujoco.MjModel:
        return mujoco.MjModel.from_xml_string(SCENE)

    def configuration(self, states: Floats) -> Doubles:
        turn = np.arctan2(states[..., 3:4], states[..., 2:3])
        return np.concatenate([states[..., :2], turn], axis=-1).astype(np.float64)


class Slide(Episode):
    """N pucks in motion."""

    def __init__(self, control_step: float, s0: Floats, seeds: Seeds | None) -> None:
        self.control_step, self.states = control_step, s0.astype(np.float64)
        self.unobserved = np.empty((len(s0), 0), np.float32)
        self.noise = None
        if seeds is not None:
            self.noise = Noise([np.random.default_rng(s) for s in seeds], (2,), 1)

    def step(self, actions: Floats) -> Floats:
        force = actions if self.noise is None else actions + 0.4 * self.noise.step()
        position, velocity = self.states[:, :2], self.states[:, 2:]
        velocity = velocity + force * self.control_step
        position = position + velocity * self.control_step
        self.states = np.concatenate([position, velocity], axis=-1)
        return self.states.astype(np.float32)


def examples(simulator: Simulator, count: int = 2, samples: int = 40) -> list[Example]:
    """Examples with forecasts of too low variance, from an ensemble of three members."""
    titles = ("median", "best", "worst", "most bimodal", "most certain", "least certain", "first")
    scenarios = simulator.sample_scenarios(spawn(1, count))
    actions = simulator.plan(scenarios, spawn(2, count))
    built = []
    for index in range(count):
        s0 = np.repeat(scenarios.s0[index : index + 1], samples, axis=0)
        plan = np.repeat(actions[index : index + 1], samples, axis=0)
        observed = simulator.rollout(s0, plan, spawn(3 + index, samples)).states[:, 1:]
        other = simulator.rollout(s0, plan, spawn(90 + index, samples)).states[:, 1:]
        forecast = observed.mean(axis=0) + 0.6 * (other - other.mean(axis=0))
        built.append(
            Example(
                title=titles[index % 7],
                description=f"Scenario {10 * index}: its MMD² is the {titles[index % 7]} of all.",
                s0=scenarios.s0[index],
                actions=actions[index],
                goal=scenarios.goal[index],
                observed=observed,
                forecast=forecast.astype(np.float32),
                member=np.arange(samples) % 3,
                members=other[:3],
                aleatoric=np.linspace(0.0, 0.03, other.shape[1]),
                epistemic=np.linspace(-0.001, 0.01, other.shape[1]),
            )
        )
    return built


def trials() -> list[Trial]:
    """A search in which some trials were pruned, and one failed."""
    random = np.random.default_rng(0)
    search: list[Trial] = []
    for number in range(14):
        beta = float(10 ** random.uniform(-4, 0))
        level = 0.2 + 0.08 * (np.log10(beta) + 2) ** 2
        steps = range(0, 1000, 100)
        noise = 0.02 * random.normal(size=10)
        curve = {s: float(level + np.exp(-s / 200) + n) for s, n in zip(steps, noise, strict=True)}
        state = "failed" if number == 5 else "pruned" if level > 0.35 else "complete"
        if state != "complete":
            curve = dict(list(curve.items())[: 4 if state == "pruned" else 0])
        score = None if state == "failed" else list(curve.values())[-1]
        search.append(Trial(number, beta, state, score, curve))
    return search


def scores(dimensions: tuple[str, ...] = ("x", "y", "ẋ", "ẏ"), steps: int = 30) -> pd.DataFrame:
    """A cell's tidy scores."""
    random = np.random.default_rng(0)
    rows: list[tuple[str, str, int, int, float]] = []
    walk = np.abs(0.1 + 0.02 * random.normal(size=(len(dimensions), steps)).cumsum(axis=1))
    for metric, values in (("mmd2", 0.1 * walk), ("variance_ratio", 0.5 + 2 * walk)):
        for name, curve in zip(dimensions, values, strict=True):
            rows += [(metric, name, step + 1, -1, float(v)) for step, v in enumerate(curve)]
            rows.append((metric, name, -1, -1, float(curve.mean())))
        mean = values.mean(axis=0)
        rows += [(metric, "all", step + 1, -1, float(v)) for step, v in enumerate(mean)]
        rows.append((metric, "all", -1, -1, float(values.mean())))
    rows += [("brier", "all", -1, -1, 0.171), ("mmd", "all", -1, -1, 0.21)]
    truth = random.uniform(size=250)
    forecast = np.round(np.clip(truth + 0.15 * random.normal(size=250), 0, 1), 2)
    for scenario in range(250):
        rows.append(("observed_probability", "all", -1, scenario, float(truth[scenario])))
        rows.append(("forecast_probability", "all", -1, scenario, float(forecast[scenario])))
    return pd.DataFrame(rows, columns=["metric", "dimension", "step", "scenario", "value"])


def study_scores(seeds: int = 1) -> pd.DataFrame:
    """The scores of a small study: three models at two levels, and a model the paper lacks."""
    random = np.random.default_rng(1)
    tables = []
    for environment in ("puck", "sledge"):
        for level in ("low", "high"):
            for model in ("residual_vae", "full_vae", "drift", "oracle"):
                for seed in range(seeds):
                    table = scores(("x", "y"), 12 if environment == "puck" else 20)
                    # The oracle does not depend on the level.
                    table["value"] *= 0.01 if model == "oracle" else random.uniform(0.5, 2.0)
                    if model == "oracle":
                        rows = table[(table["metric"] == "mmd2") & (table["dimension"] == "all")]
                        table = pd.concat([table, rows.assign(metric="mmd2_shift_1")])
                    cell = {"environment": environment, "level": level, "model": model}
                    tables.append(table.assign(**cell, seed=seed))
    return pd.concat(tables, ignore_index=True)


def require_driver() -> None:
    """Skip a test where the viewer cannot draw; in continuous integration, fail it."""
    if not has_driver():
        reason = "no Vulkan driver (apt-get install mesa-vulkan-drivers)"
        pytest.fail(reason) if os.environ.get("CI") else pytest.skip(reason)


TEXTS = {
    "Brier scores": "# Brier scores\n\n| | one |\n|---|---|\n| low | **0.2**<br>paper 0.3 |",
    "Claims": "# Claims\n\nOf 2 claims of the paper: 1 reproduced, 1 partly, as can be seen.",
}

PROPERTIES: dict[str, str | int | float] = {
    "cell": "puck/low/residual_vae/seed-0",
    "seed": 0,
    "config": '{"train": {"steps": 100}}',
    "rerun": "0.41.0",
}
