"""Forecasts of many scenarios in parts, and the ensemble members behind them."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch

from study.common.arrays import Floats, Integers
from study.common.errors import StudyError
from study.common.progress import Progress
from study.common.registry import full_name
from study.common.seeds import Seeds
from study.config.names import ENSEMBLE, ORACLE
from study.data.storage import Arrays
from study.data.trajectories import ScenarioSet
from study.envs import Simulator
from study.models.base import Forecaster, Model
from study.models.checkpoints import fitted_ensemble, load_model
from study.models.model_ensemble import EnsembleOfModels
from study.models.oracle import Oracle
from study.models.rnn_ensemble import RnnEnsemble
from study.models.sampling import sample_members

CHUNK = 512
"""Largest number of trajectories in one batch of an ensemble. It bounds the memory."""

AnyEnsemble = RnnEnsemble | EnsembleOfModels[Any, Any]


def load_forecaster(name: str, simulator: Simulator, inputs: Mapping[str, Path]) -> Forecaster:
    """The forecaster of a cell: the oracle, the ensemble alone, or a trained model.

    Args:
        name: ``oracle``, ``ensemble`` or the name of a registered model.
        simulator: of the cell's environment.
        inputs: folders of earlier stages, ``ensemble`` or ``trained``.

    Raises:
        StudyError: another version of the study wrote the weights.
    """
    if name == ORACLE:
        return Oracle(simulator)
    if name == ENSEMBLE:
        return load_model(inputs["ensemble"] / "ensemble.safetensors")
    return load_model(inputs["trained"] / "model.safetensors")


def forecast_in_parts(
    forecaster: Forecaster, test: ScenarioSet, samples: int, seeds: Seeds, progress: Progress
) -> Floats:
    """`Forecaster.forecast` of all scenarios [S, K, T, D]. It reports progress after each tenth.

    Raises:
        StudyError: the forecasts have the wrong shape.
    """
    parts = np.array_split(np.arange(len(test)), min(10, len(test)))
    forecasts = []
    for count, part in enumerate(parts, start=1):
        s0, actions = test.s0[part], test.actions[part]
        forecast = forecaster.forecast(s0, actions, samples, seeds[part])
        expected = (len(part), samples, actions.shape[1], s0.shape[1])
        if np.shape(forecast) != expected:
            raise StudyError(
                f"{full_name(type(forecaster))}.forecast returned {list(np.shape(forecast))}, "
                f"wanted {list(expected)}"
            )
        forecasts.append(forecast)
        progress(count / len(parts), "forecasting")
    return np.concatenate(forecasts)


def forecast_members(model: AnyEnsemble, s0: Floats, actions: Floats) -> Floats:
    """ŷ_m of all members [N, M, T, D] in SI units.

    Args:
        model: the ensemble.
        s0: [N, D] in SI units.
        actions: [N, T, A] in SI units.
    """
    return np.concatenate(list(forecast_members_in_parts(model, s0, actions)))


@torch.no_grad()
def forecast_members_in_parts(model: AnyEnsemble, s0: Floats, actions: Floats) -> Iterator[Floats]:
    """See `forecast_members`: parts of at most `CHUNK` trajectories."""
    for start in range(0, len(s0), CHUNK):
        chunk = slice(start, start + CHUNK)
        inputs = model.normalize(torch.from_numpy(s0[chunk]), torch.from_numpy(actions[chunk]))
        yield model.denormalize(model(*inputs)).cpu().numpy()


def example_arrays(
    forecaster: Forecaster, test: ScenarioSet, forecasts: Floats, seeds: Seeds, index: Integers
) -> Arrays:
    """The scenarios and forecasts that a recording shows.

    Args:
        forecaster: source of the forecasts.
        test: all S scenarios.
        forecasts: [S, K, T, D] in SI units.
        seeds: of the forecasts, [S].
        index: the E scenarios that the recording shows, [E].

    Returns:
        ``scenario`` [E], ``s0`` [E, D], ``actions`` [E, T, A], ``goal`` [E, G], ``observed`` and
        ``forecast`` [E, K, T, D]. With an ensemble also ``member`` [E, K], the member of each
        sample, and ``members`` [E, M, T, D], the forecast of each member.
    """
    arrays: Arrays = {
        "scenario": index,
        "s0": test.s0[index],
        "actions": test.actions[index],
        "goal": test.goal[index],
        "observed": test.observed[index],
        "forecast": forecasts[index],
    }
    ensemble = ensemble_of(forecaster)
    member = members_of_samples(forecaster, seeds, forecasts.shape[1])
    if ensemble is not None and member is not None:
        arrays["member"] = member[index]
        arrays["members"] = forecast_members(ensemble, test.s0[index], test.actions[index])
    return arrays


def ensemble_of(forecaster: Forecaster) -> AnyEnsemble | None:
    """The ensemble that a forecaster is or contains; None without an ensemble."""
    if isinstance(forecaster, RnnEnsemble | EnsembleOfModels):
        return forecaster
    return fitted_ensemble(forecaster) if isinstance(forecaster, Model) else None


def members_of_samples(forecaster: Forecaster, seeds: Seeds, samples: int) -> Integers | None:
    """The member of each sample [S, K] of `Forecaster.forecast`; None if there is one member.

    Args:
        forecaster: source of the forecasts.
        seeds: of the forecasts, [S].
        samples: K.
    """
    count = forecaster.members_count() if isinstance(forecaster, Model) else 1
    return sample_members(seeds, samples, count) if count > 1 else None
