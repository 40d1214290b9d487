"""How fast models forecast: ``python -m tests.benchmarks.forecasting``.

Sampled transitions per second on one thread, each contender in turn, for each environment:

- *ours*: `Model.forecast`, random numbers and units included;
- *simulator*: `repeat_rollouts`, as stage collect observes the test scenarios;
- *torch.nn*: the same model with its networks in `torch.nn` (`tests/benchmarks/plain.py`), without
  derivatives.

The ensemble computes each member's forecast of a scenario once, whatever the number of samples. It
gets more scenarios than the others.
"""

import argparse
from collections.abc import Callable
from typing import Any

import numpy as np

from study.common.progress import Progress
from study.common.seeds import spawn
from study.config.settings import Config
from study.data.trajectories import Trajectories
from study.envs import simulators
from study.envs.observe import repeat_rollouts
from tests.benchmarks.plain import plain
from tests.benchmarks.report import save
from tests.benchmarks.sizes import MODELS, SIZES, build_model, observe
from tests.benchmarks.timing import as_a_worker, interleave, times_as_fast

SAMPLES, SCENARIOS, SIMULATED = 100, 40, 10
"""Samples of each scenario; scenarios that are forecast; scenarios that are simulated."""
LARGEST_DIFFERENCE = 1e-3
"""Between our forecasts and those of `torch.nn`, normalized."""
SIMULATOR, PLAIN = "simulator", "torch.nn"

Contender = tuple[Callable[[], object], int]
"""What is timed, and how many transitions it samples."""


def simulation(environment: str, data: Trajectories) -> Contender:
    """Rollouts of the simulator."""
    simulator = simulators[environment](horizon=data.horizon)
    s0, actions = data.states[:SIMULATED, 0], data.actions[:SIMULATED]
    seeds = spawn(0, SIMULATED)

    def run() -> object:
        return list(repeat_rollouts(simulator, s0, actions, SAMPLES, seeds, Progress()))

    return run, SIMULATED * SAMPLES * data.horizon


def forecasts(name: str, config: Config, data: Trajectories) -> dict[str, Contender]:
    """Forecasts of a model, ours and by `torch.nn`."""
    count = len(data) if name == "ensemble" else SCENARIOS
    s0, actions, seeds = data.states[:count, 0], data.actions[:count], spawn(0, count)
    work = count * SAMPLES * data.horizon
    model = build_model(name, config, data).eval()
    found: dict[str, Contender] = {
        "ours": (lambda: model.forecast(s0, actions, SAMPLES, seeds), work)
    }
    if name != "probabilistic_mlp":
        copy = plain(model).eval()
        one = (s0[:1], actions[:1], 2, seeds[:1])
        difference = np.abs(model.forecast(*one) - copy.forecast(*one)) / model.state_scale.numpy()
        assert difference.max() < LARGEST_DIFFERENCE, f"{name}: {difference.max()}"
        found[PLAIN] = lambda: copy.forecast(s0, actions, SAMPLES, seeds), work
    return found


def measure(environment: str, size: str, data: Trajectories, repeats: int) -> list[dict[str, Any]]:
    """The rows of one environment and size."""
    timed = {(SIMULATOR, SIMULATOR): simulation(environment, data)}
    for name in MODELS:
        for contender, run in forecasts(name, SIZES[size], data).items():
            timed[name, contender] = run
    runs = {"/".join(key): run for key, (run, _) in timed.items()}
    timings = interleave(runs, repeats)
    rows = []
    for name in MODELS:
        ours, work = timings[f"{name}/ours"], timed[name, "ours"][1]
        others = {"ours": (name, "ours"), SIMULATOR: (SIMULATOR, SIMULATOR), PLAIN: (name, PLAIN)}
        for contender, key in others.items():
            if key in timed:
                theirs, their_work = timings["/".join(key)], timed[key][1]
                rows.append(
                    {
                        "environment": environment,
                        "size": size,
                        "model": name,
                        "contender": contender,
                        "rate": their_work / theirs.median(),
                        "ratio": times_as_fast(ours, theirs, work / their_work),
                    }
                )
    return rows


def main() -> None:
    """Measure, print and save."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--environments", nargs="+", default=["pusher", "uav"])
    parser.add_argument("--repeats", type=int, default=3)
    arguments = parser.parse_args()
    as_a_worker()
    rows = []
    for environment in arguments.environments:
        data = observe(environment, 4 * SCENARIOS)
        for size in SIZES:
            measured = measure(environment, size, data, arguments.repeats)
            for row in measured:
                name = "{environment:7} {size:6} {model:18} {contender:10}".format(**row)
                print(f"{name} {row['rate']:12,.0f} /s; ours × {row['ratio'][0]:.2f}", flush=True)
            rows += measured
    save("forecasting", rows)


if __name__ == "__main__":
    main()
