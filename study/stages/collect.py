"""Stage collect: observe one environment.

Writes ``train.safetensors`` (Trajectories), ``validation.safetensors`` and ``test.safetensors``
(ScenarioSets), and ``kernel.json``: the units and bandwidths in which every forecast is scored.
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from study.common.arrays import Floats
from study.common.progress import Progress
from study.common.seeds import derive
from study.config.recorded import Recorded
from study.config.stage_settings import CollectSettings
from study.data.kernel import Kernel
from study.data.moments import moments
from study.data.recorded.windows import SIDES
from study.data.storage import load_parts
from study.data.trajectories import ScenarioSet, save_all
from study.envs.observe import CHUNK, observe_scenarios, observe_training, real_system
from study.envs.recorded import facts_of, scenarios_of, training_of, windows_of
from study.metrics.mmd import bandwidths

VALIDATION_ROLLOUTS = 4
"""Rollouts of each validation scenario. MMD² needs at least two."""


def run(
    settings: CollectSettings, inputs: Mapping[str, Path], out: Path, progress: Progress
) -> None:
    """Run the stage. Training, validation and test scenarios have separate seeds."""
    if settings.recorded is not None:
        _read_logs(settings, settings.recorded, out, progress)
    else:
        _simulate(settings, out, progress)
    # Bandwidths come from validation rollouts: the test set is used for scores alone.
    validation = ScenarioSet.load(out / "validation.safetensors")
    _, scale = moments(lambda: load_parts(out / "train.safetensors", "states", CHUNK))
    bandwidth = bandwidths(_repeated(validation), scale)
    names = tuple(variable["name"] for variable in validation.facts["state"])
    Kernel(names, scale, bandwidth).save(out)


def _simulate(settings: CollectSettings, out: Path, progress: Progress) -> None:
    """Write the data sets of a simulator."""
    collect = settings.collect
    simulator, seed = real_system(settings.environment, collect)
    training = observe_training(settings.environment, collect, progress.part(0.0, 0.5))
    save_all(out / "train.safetensors", training, collect.trajectories)
    for name, count, rollouts, part in (
        ("validation", collect.validation, VALIDATION_ROLLOUTS, progress.part(0.5, 0.6)),
        ("test", collect.scenarios, collect.rollouts, progress.part(0.6, 1.0)),
    ):
        scenarios = observe_scenarios(simulator, count, rollouts, derive(seed, name), part, name)
        save_all(out / f"{name}.safetensors", scenarios, count)


def _read_logs(
    settings: CollectSettings, recorded: Recorded, out: Path, progress: Progress
) -> None:
    """Write the data sets of a recorded system. A test scenario was observed once."""
    name, seed = settings.environment, derive(settings.environment, settings.collect.seed)
    split = windows_of(name, recorded, settings.collect, progress.part(0.0, 0.5))
    facts = facts_of(name, recorded, split, seed)
    train, validation, test = (split.windows[side] for side in SIDES)
    save_all(out / "train.safetensors", training_of(train, facts), len(train))
    for side, windows in (("validation", validation), ("test", test)):
        save_all(out / f"{side}.safetensors", scenarios_of(windows, facts), len(windows))


def _repeated(validation: ScenarioSet) -> Floats:
    """Rollouts whose distances give the bandwidths [S, K, T, D], K ≥ 2.

    Of scenarios that were observed once, two at a time count as rollouts of one scenario.
    """
    observed = validation.observed
    if observed.shape[1] > 1:
        return observed
    order = np.random.default_rng(0).permutation(len(observed))
    pairs = observed[order[: len(order) // 2 * 2], 0]
    return pairs.reshape(-1, 2, *pairs.shape[1:])
