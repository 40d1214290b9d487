"""The real systems. Every module in this folder registers itself when it is imported."""

import importlib
import pkgutil

from study.envs.simulator import Rollout, Scenarios, Simulator, Variable, simulators

__all__ = ["Rollout", "Scenarios", "Simulator", "Variable", "simulators"]

for _module in pkgutil.iter_modules(__path__):
    importlib.import_module(f"{__name__}.{_module.name}")
