"""A reproducibility study: forecasting aleatoric and epistemic uncertainty over long horizons.

`check_simulator` and `check_model` check a class of one's own, as Gymnasium's `check_env` does.
"""

import importlib
from typing import Any

__version__ = "0.1.0"

CHECKS = {"check_simulator": "study.envs.check", "check_model": "study.models.check"}
"""Functions that are imported when they are first used, since torch takes seconds to import."""


def __getattr__(name: str) -> Any:
    if name not in CHECKS:
        raise AttributeError(f"module 'study' has no attribute '{name}'")
    return getattr(importlib.import_module(CHECKS[name]), name)
