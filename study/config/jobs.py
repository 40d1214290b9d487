"""Checks of the settings of jobs of a batch system."""

import re

from study.common.errors import BadInput, shown
from study.config.settings import Engine

WALLTIME = re.compile(r"(?:(\d+)-)?(\d+):(\d\d):(\d\d)")
MEMORY = re.compile(r"\d+(\.\d+)?[KMGT]i?B")
SHORTEST = 20
"""Seconds of a walltime at least, to start a worker."""


def check_jobs(engine: Engine) -> None:
    """Check the settings of the kind `slurm`.

    Raises:
        BadInput: names the setting, what was given and what is allowed.
    """
    if engine.kind != "slurm":
        return
    if not MEMORY.fullmatch(engine.memory):
        raise BadInput(
            f"engine.memory: got {shown(engine.memory)}; write a size of a job such as 8GB"
        )
    if engine.cores < engine.threads:
        raise BadInput(
            f"engine.cores: got {engine.cores}; at least engine.threads, {engine.threads}"
        )
    if walltime_seconds(engine) < SHORTEST:
        raise BadInput(
            f"engine.walltime: got {shown(engine.walltime)}; at least {SHORTEST} seconds"
        )


def walltime_seconds(engine: Engine) -> int:
    """The walltime of a job in seconds.

    Raises:
        BadInput: it is no time.
    """
    match = WALLTIME.fullmatch(engine.walltime)
    if match is None:
        raise BadInput(
            f"engine.walltime: got {shown(engine.walltime)}; write hours as 12:00:00, or days as "
            "2-00:00:00"
        )
    days, hours, minutes, seconds = (int(part or 0) for part in match.groups())
    return ((24 * days + hours) * 60 + minutes) * 60 + seconds


def workers_of_job(engine: Engine) -> int:
    """The number of worker processes of a job."""
    return max(1, engine.cores // engine.threads)
