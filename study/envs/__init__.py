"""The real systems. Every module in this folder registers itself when it is imported."""

import importlib
import pkgutil

from study.envs.registration import gymnasium_id, register
from study.envs.simulator import (
    Episode,
    Policy,
    Rollout,
    Scenarios,
    Simulator,
    Variable,
    simulators,
)

__all__ = [
    "Episode",
    "Policy",
    "Rollout",
    "Scenarios",
    "Simulator",
    "Variable",
    "gymnasium_id",
    "register",
    "simulators",
]

for _module in pkgutil.iter_modules(__path__):
    if not _module.ispkg:
        importlib.import_module(f"{__name__}.{_module.name}")
