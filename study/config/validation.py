"""Checks of settings before anything is written: bounds, choices, and settings that conflict."""

from dataclasses import fields, is_dataclass
from typing import Any

from study.common.errors import BadInput, nearest
from study.config.settings import Config


def check(config: Any, prefix: str = "") -> None:
    """Check every setting.

    Raises:
        BadInput: names the setting, what was given and what is allowed.
    """
    for entry in fields(config):
        value, name = getattr(config, entry.name), prefix + entry.name
        if is_dataclass(value):
            check(value, name + ".")
            continue
        values = value if isinstance(value, tuple) else (value,)
        if isinstance(value, tuple):
            if not value and entry.name not in ("plugins", "ablations"):
                raise BadInput(f"{name}: got an empty list; give at least one value")
            if len(set(value)) < len(value):
                raise BadInput(f"{name}: got {list(value)}; each value may stand there once")
        for item in values:
            _check_value(name, item, **entry.metadata)
    if isinstance(config, Config):
        _check_together(config)


def _check_value(
    name: str, value: Any, low: Any = None, high: Any = None, choices: tuple[str, ...] = ()
) -> None:
    if value is None:
        return
    if choices and value not in choices:
        raise BadInput(f"{name}: got '{value}'; {nearest(str(value), choices)}")
    # `not (…)` refuses NaN as well.
    if (low is not None and not value >= low) or (high is not None and not value <= high):
        bounds = f"at least {low}" if high is None else f"between {low} and {high}"
        raise BadInput(f"{name}: got {value}; it must be {bounds}")


def _check_together(config: Config) -> None:
    """Checks that involve several settings."""
    for level in config.grid.levels:
        if level not in ("low", "high"):
            raise BadInput(f"grid.levels: got '{level}'; {nearest(level, ('low', 'high'))}")
    tune, collect = config.tune, config.collect
    if tune.beta_low > tune.beta_high:
        raise BadInput(
            f"tune.beta_low: got {tune.beta_low}; it must be at most tune.beta_high, "
            f"{tune.beta_high}"
        )
    if tune.evaluations > tune.steps:
        raise BadInput(
            f"tune.evaluations: got {tune.evaluations}; at most tune.steps, {tune.steps}"
        )
    if collect.trajectories // collect.reduction < 2:
        raise BadInput(
            f"collect.trajectories: got {collect.trajectories}; level high needs at least 2, so "
            f"at least {2 * collect.reduction} with collect.reduction {collect.reduction}"
        )
    crps = config.crps
    if crps.persistent_noise_size >= crps.noise_size:
        raise BadInput(
            f"crps.persistent_noise_size: got {crps.persistent_noise_size}; "
            f"less than crps.noise_size, {crps.noise_size}"
        )
    if config.ensemble.cross_fit and config.ensemble.members < 2:
        raise BadInput("ensemble.members: got 1; ensemble.cross_fit needs at least 2")
    if not config.name or "/" in config.name or config.name.startswith("."):
        raise BadInput(f"name: got '{config.name}'; it names a folder: letters, digits, - and _")
