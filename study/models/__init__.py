"""The forecasters. Every module in this folder registers itself when it is imported."""

import importlib
import pkgutil

from study.models.base import Forecaster, Model, models

__all__ = ["Forecaster", "Model", "models"]

for _module in pkgutil.iter_modules(__path__):
    if not _module.ispkg:
        importlib.import_module(f"{__name__}.{_module.name}")
