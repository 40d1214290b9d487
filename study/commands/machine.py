"""What a command needs of this machine, checked before any work."""

from collections.abc import Iterable

from study.common.errors import BadInput
from study.config.settings import Config
from study.workflow.meter import memory_size
from study.workflow.store import Store
from study.workflow.task import Task

COPIES = 8
"""How often forecasts are in memory at the same time, about."""
FLOAT = 4
"""Bytes of a number."""
STATE = 4
"""Numbers of a state, at least."""


def check_accelerator(config: Config, tasks: Iterable[Task], store: Store) -> None:
    """Check that the accelerator exists, unless no task has to run.

    Raises:
        BadInput: it does not.
    """
    if config.train.accelerator == "gpu" and any(map(store.reason_to_run, tasks)):
        import torch

        if not (torch.cuda.is_available() or torch.backends.mps.is_available()):
            raise BadInput("train.accelerator: got 'gpu', and torch finds none here; give auto")


def check_samples(name: str, samples: int, rows: int) -> None:
    """Check that forecasts fit into memory.

    Args:
        name: the flag or the setting with the number of samples.
        samples: K, the number of forecasts of a scenario.
        rows: the numbers of a forecast of all scenarios together: S times T times D.

    Raises:
        BadInput: they do not.
    """
    most = memory_size() // (COPIES * FLOAT * rows)
    if samples > most:
        needed = samples * COPIES * FLOAT * rows / 2**30
        raise BadInput(
            f"{name}: got {samples}, which needs about {needed:.3g} GiB of memory; at most {most} "
            "on this machine"
        )


def check_memory(config: Config) -> None:
    """Check that what a stage has in memory at the same time can fit into it.

    Raises:
        BadInput: it cannot, even for a system with the smallest state.
    """
    collect, tune = config.collect, config.tune
    steps = (collect.horizon or 1) * STATE
    check_samples("evaluate.samples", config.evaluate.samples, collect.scenarios * steps)
    check_samples("collect.rollouts", collect.rollouts, collect.scenarios * steps)
    check_samples("tune.samples", tune.samples, tune.validation * steps)
