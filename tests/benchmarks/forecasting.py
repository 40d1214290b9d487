"""How fast models forecast: ``python -m tests.benchmarks.forecasting``.

Sampled transitions per second, on one thread, in turn, for each environment:

- *simulator*: `repeat_rollouts`, as stage collect observes the test scenarios: what a forecast has
  to be faster than, to be worth its errors;
- *ours*: `Model.forecast`, random numbers and units included;
- *torch.nn*: the same with its recurrent networks written with `GRUCell`
  (`tests/benchmarks/plain.py`), without derivatives.

The ensemble's K samples of a scenario are M forecasts, each computed once: it alone is given more
scenarios for it.
"""

import argparse
from collections.abc import Callable

import numpy as np

from study.common.progress import Progress
from study.common.seeds import spawn
from study.config.settings import Config
from study.data.trajectories import Trajectories
from study.envs import simulators
from study.envs.observe import repeat_rollouts
from tests.benchmarks.plain import plain
from tests.benchmarks.sizes import MODELS, SIZES, built, observe
from tests.benchmarks.timing import as_a_worker, interleave, times_as_fast, verdict

PLAIN_TARGET, SIMULATOR_TARGET = 3.0, 1.0
SAMPLES, SCENARIOS, SIMULATED = 100, 40, 10
"""Of each scenario; forecast; simulated, since that is slower."""


def contenders(
    environment: str, config: Config, data: Trajectories
) -> dict[str, tuple[Callable[[], object], int]]:
    """What is timed, and how many transitions it samples."""
    simulator = simulators[environment](horizon=data.horizon)
    s0, actions, seeds = data.states[:, 0], data.actions, spawn(0, len(data))
    few = slice(SIMULATED)
    found: dict[str, tuple[Callable[[], object], int]] = {
        "simulator": (
            lambda: list(
                repeat_rollouts(simulator, s0[few], actions[few], SAMPLES, seeds[few], Progress())
            ),
            SIMULATED * SAMPLES * data.horizon,
        )
    }
    for name in MODELS:
        count = len(data) if name == "ensemble" else SCENARIOS
        given = (s0[:count], actions[:count], SAMPLES, seeds[:count])
        model = built(name, config, data).eval()
        work = count * SAMPLES * data.horizon
        # Bound to its own model: each name is of this turn of the loop.
        found[name] = (lambda model=model, given=given: model.forecast(*given), work)  # type: ignore[misc]
        if name == "probabilistic_mlp":
            continue
        rival = plain(model).eval()
        one = (s0[:1], actions[:1], 2, seeds[:1])
        apart = np.abs(model.forecast(*one) - rival.forecast(*one)) / model.state_scale.numpy()
        assert apart.max() < 1e-3, f"{name}: torch.nn's forecast is off by {apart.max()}"
        found[f"{name} by torch.nn"] = (
            lambda model=rival, given=given: model.forecast(*given),  # type: ignore[misc]
            work,
        )
    return found


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--environments", nargs="+", default=["pusher", "uav"])
    parser.add_argument("--repeats", type=int, default=3)
    given = parser.parse_args()
    as_a_worker()
    for environment in given.environments:
        data = observe(environment, 4 * SCENARIOS)
        for size, config in SIZES.items():
            print(f"\n{environment}, {size} size, {SAMPLES} samples, horizon {data.horizon}")
            timed = contenders(environment, config, data)
            timings = interleave({name: run for name, (run, _) in timed.items()}, given.repeats)
            for name, (_, work) in timed.items():
                rate = work / timings[name].median()
                line = f"  {name:30} {rate:12,.0f} transitions/s"
                if name in MODELS:
                    share = work / timed["simulator"][1]
                    ratio, least, most = times_as_fast(timings[name], timings["simulator"], share)
                    line += f"   {ratio:5.1f} × the simulator ({least:.1f} to {most:.1f})"
                    line += f", {verdict(ratio, SIMULATOR_TARGET)}"
                    rival = f"{name} by torch.nn"
                    if rival in timed:
                        ratio, least, most = times_as_fast(timings[name], timings[rival])
                        line += f"   {ratio:4.2f} × torch.nn ({least:.2f} to {most:.2f})"
                        line += f", {verdict(ratio, PLAIN_TARGET)}"
                print(line)


if __name__ == "__main__":
    main()
