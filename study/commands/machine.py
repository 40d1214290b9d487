"""Checks of this machine's accelerator and memory before a command starts to work."""

from collections.abc import Iterable

from study.common.errors import BadInput
from study.config.settings import Config
from study.workflow.meter import memory_size
from study.workflow.store import Store
from study.workflow.task import Task

COPIES = 8
"""Approximate number of copies of the forecasts in memory."""
FLOAT = 4
"""Bytes of a number."""
STATE = 4
"""Smallest size D of a state that is assumed."""


def check_accelerator(config: Config, tasks: Iterable[Task], store: Store) -> None:
    """Check that the accelerator exists, unless no task has to run.

    Raises:
        BadInput: torch finds no accelerator.
    """
    if config.engine.address or config.engine.kind == "slurm":
        return  # the fits run elsewhere; `study.workflow.cluster` asks the workers
    if config.train.accelerator == "gpu" and any(map(store.reason_to_run, tasks)):
        import torch

        if not (torch.cuda.is_available() or torch.backends.mps.is_available()):
            raise BadInput(
                "train.accelerator: got 'gpu', and torch finds none here; give auto or cpu"
            )


def check_samples(name: str, samples: int, rows: int) -> None:
    """Check that forecasts fit into memory.

    Args:
        name: the flag or the setting with the number of samples.
        samples: K, the number of forecasts of a scenario.
        rows: S · T · D, the numbers of one forecast of all scenarios.

    Raises:
        BadInput: the forecasts do not fit.
    """
    most = memory_size() // (COPIES * FLOAT * rows)
    if samples > most:
        needed = samples * COPIES * FLOAT * rows / 2**30
        raise BadInput(
            f"{name}: got {samples}, which needs about {needed:.3g} GiB of memory; at most {most} "
            "on this machine"
        )


def check_memory(config: Config) -> None:
    """Check that the trajectories of every stage fit into memory.

    Raises:
        BadInput: the trajectories do not fit, even for a system with the smallest state.
    """
    collect, tune = config.collect, config.tune
    steps = (collect.horizon or 1) * STATE
    check_samples("evaluate.samples", config.evaluate.samples, collect.scenarios * steps)
    check_samples("collect.rollouts", collect.rollouts, collect.scenarios * steps)
    check_samples("tune.samples", tune.samples, tune.validation * steps)
