"""The cost of one piece of work, for `tests.benchmarks.scale`."""

import resource
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

from study.common.progress import Progress
from study.common.seeds import spawn
from study.config.settings import Collect, Config
from study.config.stage_settings import CollectSettings
from study.envs import Rollout
from study.envs.pusher import Pusher
from study.stages import collect
from tests.benchmarks.sizes import build_model, observe
from tests.benchmarks.training import BATCH, batch_for, step_of

SCENARIOS = 16
"""Scenarios of a timed forecast."""
STEPS = 3
"""Training steps; the first is not measured."""


@dataclass(frozen=True)
class Cost:
    """Processor seconds, and bytes at the peak."""

    seconds: float
    memory: float


def cost_of(work: Callable[[], object]) -> Cost:
    """The cost of doing the work once."""
    before, start = _peak(), time.process_time()
    work()
    seconds = time.process_time() - start
    return Cost(seconds, _peak() - before)


def _peak() -> float:
    """Peak memory of this process in bytes."""
    # Bytes on macOS, kibibytes elsewhere.
    unit = 1 if sys.platform == "darwin" else 1024
    return float(unit * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)


def collection(count: int, physics: bool) -> Cost:
    """Stage collect, with two validation and two test scenarios."""
    sizes = Collect(trajectories=count, validation=2, scenarios=2, rollouts=2)
    settings = CollectSettings("pusher", sizes)

    def constant_plan(self: Pusher, scenarios: Any, seeds: Any) -> Any:
        return np.full((len(seeds), self.horizon, len(self.action)), 0.5, np.float32)

    def constant_rollout(self: Pusher, s0: Any, actions: Any, seeds: Any = None) -> Rollout:
        shape = (len(s0), self.horizon + 1, len(self.state))
        states = np.full(shape, 0.5, np.float32) + s0[:, None]
        return Rollout(states, np.zeros((len(s0), len(self.unobserved)), np.float32))

    def work() -> None:
        with tempfile.TemporaryDirectory() as folder:
            collect.run(settings, {}, Path(folder), Progress())

    if physics:
        return cost_of(work)
    with mock.patch.multiple(Pusher, plan=constant_plan, rollout=constant_rollout):
        return cost_of(work)


def training(name: str, config: Config, horizon: int | None = None) -> Cost:
    """One training step on one batch."""
    data = observe("pusher", BATCH, horizon)
    model = build_model(name, config, data)
    step = step_of(model, batch_for(name, config, model, data))
    costs = [cost_of(step) for _ in range(STEPS)]
    return Cost(
        float(np.median([cost.seconds for cost in costs[1:]])),
        max(cost.memory for cost in costs),
    )


def forecasting(name: str, config: Config, samples: int, horizon: int | None = None) -> Cost:
    """Forecasts of `SCENARIOS` scenarios."""
    data = observe("pusher", SCENARIOS, horizon)
    model = build_model(name, config, data).eval()
    s0, actions, seeds = data.states[:, 0], data.actions, spawn(0, len(data))
    model.forecast(s0[:1], actions[:1], 2, seeds[:1])
    return cost_of(lambda: model.forecast(s0, actions, samples, seeds))
