"""Stage collect: observe one environment.

Writes ``train.safetensors`` (Trajectories), ``validation.safetensors`` and ``test.safetensors``
(ScenarioSets), and ``kernel.json``: the units and bandwidths in which every forecast is scored.
"""

from collections.abc import Mapping
from pathlib import Path

from study.common.progress import Progress
from study.common.seeds import derive
from study.config.stage_settings import CollectSettings
from study.data.kernel import Kernel
from study.data.moments import moments
from study.data.storage import load_parts
from study.data.trajectories import ScenarioSet, save_all
from study.envs.observe import CHUNK, observe_scenarios, observe_training, real_system
from study.metrics.mmd import bandwidths

VALIDATION_ROLLOUTS = 4
"""Rollouts of each validation scenario. MMD² needs at least two."""


def run(
    settings: CollectSettings, inputs: Mapping[str, Path], out: Path, progress: Progress
) -> None:
    """Run the stage. Training, validation and test scenarios have separate seeds."""
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
    # Bandwidths come from validation rollouts: the test set is used for scores alone.
    validation = ScenarioSet.load(out / "validation.safetensors")
    _, scale = moments(lambda: load_parts(out / "train.safetensors", "states", CHUNK))
    bandwidth = bandwidths(validation.observed, scale)
    names = tuple(variable.name for variable in simulator.state)
    Kernel(names, scale, bandwidth).save(out)
