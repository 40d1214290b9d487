"""Checks of settings that depend on one another."""

import math
import re

from study.common.errors import BadInput, shown
from study.common.registry import check_name
from study.common.secrets import without_passwords
from study.config.jobs import check_jobs
from study.config.settings import Config
from study.config.stage_settings import TrainingSet

DATABASE = re.compile(r"(postgresql(\+\w+)?://([^@\s]*@)?|sqlite:///)[^@\s]+")
"""URLs of `tune.storage`."""
MOST_BATCHES = 50
"""Batches of a search, each a link of a chain of tasks, at most."""
LEAST = 2
"""Training trajectories of a level, at least."""


def check_together(config: Config) -> None:
    """Check what the bounds of single settings do not say.

    Raises:
        BadInput: names the setting, what was given and what is allowed.
    """
    if not re.fullmatch(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,99}", config.name):
        raise BadInput(
            f"name: got {shown(config.name)}; it names a folder: up to 100 letters, digits, ., - "
            "and _"
        )
    _check_levels(config)
    tune = config.tune
    if tune.storage is not None and not DATABASE.fullmatch(tune.storage):
        raise BadInput(
            f"tune.storage: got {shown(without_passwords(tune.storage))}; it must be a URL such as "
            "postgresql://USER@HOST/DATABASE or sqlite:////FOLDER/FILE.db; in a password, write @ "
            "as %40 and / as %2F"
        )
    if tune.beta_low > tune.beta_high:
        raise BadInput(
            f"tune.beta_low: got {tune.beta_low}; it must be at most tune.beta_high, "
            f"{tune.beta_high}"
        )
    if tune.evaluations > tune.steps:
        raise BadInput(
            f"tune.evaluations: got {tune.evaluations}; at most tune.steps, {tune.steps}"
        )
    if tune.batch > 1 and tune.trials > MOST_BATCHES * tune.batch:
        raise BadInput(
            f"tune.batch: got {tune.batch}; {tune.trials} trials in at most {MOST_BATCHES} batches "
            f"need at least {math.ceil(tune.trials / MOST_BATCHES)}, or 1"
        )
    check_jobs(config.engine)
    address = config.engine.address
    if address and config.engine.kind != "dask":
        raise BadInput(
            f"engine.address: got {shown(address)} with engine.kind {config.engine.kind}; it needs "
            "--engine.kind dask"
        )
    if address and not re.fullmatch(r"[a-z]+://[^\s/]+:[0-9]{1,5}/?", address):
        raise BadInput(
            f"engine.address: got {shown(address)}; it must be like tcp://host:8786 or "
            "tls://host:8786"
        )
    if config.ensemble.cross_fit and config.ensemble.members < 2:
        raise BadInput("ensemble.members: got 1; ensemble.cross_fit needs at least 2")


def _check_levels(config: Config) -> None:
    total = config.collect.trajectories
    for level, fraction in config.grid.levels.items():
        check_name("level", level, "grid.levels")
        count = TrainingSet.of_level(fraction, total, 0).trajectories
        if count < LEAST:
            raise BadInput(
                f"collect.trajectories: got {total}; level {level} needs at least {LEAST}, and has "
                f"the fraction {fraction} of them"
            )
