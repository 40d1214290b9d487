"""What one piece of work costs, for `tests.benchmarks.scale`, which gives each its own process."""

import resource
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
from study.config.settings import Config
from study.envs import Rollout
from study.envs.pusher import Pusher
from study.stages import collect
from tests.benchmarks.sizes import built, observe
from tests.benchmarks.training import BATCH, batch_for, step_of

SCENARIOS = 16
"""Whose forecasts are timed."""
STEPS = 3
"""Of training, the first not counted."""


@dataclass(frozen=True)
class Cost:
    """Of one point: seconds of the processor, seconds on the clock, and bytes at the peak."""

    processor: float
    clock: float
    memory: float


def cost_of(work: Callable[[], object]) -> Cost:
    """Do it once."""
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    clock, processor = time.perf_counter(), time.process_time()
    work()
    processor, clock = time.process_time() - processor, time.perf_counter() - clock
    after = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return Cost(processor, clock, 1024.0 * (after - before))


def collection(count: int, physics: bool) -> Cost:
    """Stage collect, with two scenarios each to validate and to test on."""
    sizes = {"trajectories": count, "validation": 2, "scenarios": 2, "rollouts": 2}
    settings = {"environment": "pusher", "collect": sizes | {"horizon": None, "seed": 0}}

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
    """One step on one batch."""
    data = observe("pusher", BATCH, horizon)
    model = built(name, config, data)
    step = step_of(model, batch_for(name, config, model, data))
    costs = [cost_of(step) for _ in range(STEPS)]
    return Cost(
        float(np.median([cost.processor for cost in costs[1:]])),
        float(np.median([cost.clock for cost in costs[1:]])),
        max(cost.memory for cost in costs),
    )


def forecasting(name: str, config: Config, samples: int, horizon: int | None = None) -> Cost:
    """Forecasts of `SCENARIOS` scenarios."""
    data = observe("pusher", SCENARIOS, horizon)
    model = built(name, config, data).eval()
    s0, actions, seeds = data.states[:, 0], data.actions, spawn(0, len(data))
    model.forecast(s0[:1], actions[:1], 2, seeds[:1])
    return cost_of(lambda: model.forecast(s0, actions, samples, seeds))
