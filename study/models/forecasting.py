"""Forecasts of many scenarios, part by part, and the ensemble members behind them."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import torch

from study.common.arrays import Floats, Integers
from study.common.progress import Progress
from study.common.seeds import Seeds
from study.data.storage import Arrays
from study.data.trajectories import ScenarioSet
from study.envs import Simulator
from study.models.base import Forecaster, Model, draw_members
from study.models.checkpoints import load_model
from study.models.model_ensemble import EnsembleOf
from study.models.oracle import Oracle
from study.models.rnn_ensemble import Ensemble

CHUNK = 512
"""Trajectories that the ensemble forecasts at once: bounds the memory."""


def load_forecaster(model: str, simulator: Simulator, inputs: dict[str, Path]) -> Forecaster:
    """The cell's forecaster: the oracle, the ensemble alone, or a fitted model."""
    if model == "oracle":
        return Oracle(simulator)
    if model == "ensemble":
        return load_model(inputs["ensemble"] / "ensemble.safetensors")
    return load_model(inputs["trained"] / "model.safetensors")


def forecast_in_parts(
    forecaster: Forecaster, test: ScenarioSet, samples: int, seeds: Seeds, progress: Progress
) -> Floats:
    """`forecast` of all scenarios [S, K, T, D], a tenth of them at a time to tell progress."""
    parts = np.array_split(np.arange(len(test)), min(10, len(test)))
    forecasts = []
    for done, part in enumerate(parts, start=1):
        forecasts.append(
            forecaster.forecast(test.s0[part], test.actions[part], samples, seeds[part])
        )
        progress(done / len(parts), "forecasting")
    return np.concatenate(forecasts)


def forecast_members(model: Ensemble | EnsembleOf, s0: Floats, actions: Floats) -> Floats:
    """ŷ_m of all members [N, M, T, D] in SI units, from [N, D] and [N, T, A] in SI units."""
    return np.concatenate(list(members_in_parts(model, s0, actions)))


@torch.no_grad()
def members_in_parts(model: Ensemble | EnsembleOf, s0: Floats, actions: Floats) -> Iterator[Floats]:
    """As `forecast_members`, some trajectories at a time."""
    for start in range(0, len(s0), CHUNK):
        chunk = slice(start, start + CHUNK)
        standard = model.normalize(torch.from_numpy(s0[chunk]), torch.from_numpy(actions[chunk]))
        yield model.denormalize(model(*standard)).cpu().numpy()


def picked(
    forecaster: Forecaster,
    test: ScenarioSet,
    forecasts: Floats,
    seeds: Seeds,
    index: Integers,
) -> Arrays:
    """All that a recording shows of the scenarios `index` [P]."""
    arrays: Arrays = {
        "scenario": index,
        "s0": test.s0[index],
        "actions": test.actions[index],
        "goal": test.goal[index],
        "observed": test.observed[index],
        "forecast": forecasts[index],
    }
    ensemble, member = ensemble_of(forecaster), members_of(forecaster, seeds, forecasts.shape[1])
    if ensemble is not None and member is not None:
        arrays["member"] = member[index]
        arrays["members"] = forecast_members(ensemble, test.s0[index], test.actions[index])
    return arrays


def ensemble_of(forecaster: Forecaster) -> Ensemble | EnsembleOf | None:
    """The ensemble that a forecaster is, or has."""
    if isinstance(forecaster, Ensemble | EnsembleOf):
        return forecaster
    inner = getattr(forecaster, "ensemble", None) if isinstance(forecaster, Model) else None
    return inner if isinstance(inner, Ensemble) else None


def members_of(forecaster: Forecaster, seeds: Seeds, samples: int) -> Integers | None:
    """The member behind each sample, [S, K]; None where there is but one."""
    count = forecaster.members_count() if isinstance(forecaster, Model) else 1
    return draw_members(seeds, samples, count) if count > 1 else None
