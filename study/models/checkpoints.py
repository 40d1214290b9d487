"""A trained model as one safetensors file: its weights, its settings and its normalisation."""

import json
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.torch import load_file, save_file

from study.common.errors import BadInput, StudyError
from study.config.convert import from_json, to_json
from study.config.names import ENSEMBLE
from study.data.normalization import Normalization
from study.models import Model, models
from study.models.rnn_ensemble import RnnEnsemble
from study.models.runtime import runtime


def class_of(name: str) -> type[Model[Any]]:
    """The registered class `name`, or `RnnEnsemble`.

    Raises:
        BadInput: there is no such model.
    """
    return RnnEnsemble if name == ENSEMBLE else models[name]


def build(
    name: str,
    normalization: Normalization,
    settings: Any,
    beta: float | None = None,
    ensemble: RnnEnsemble | None = None,
) -> Model[Any]:
    """A new model.

    Args:
        name: see `class_of`.
        normalization: units of states and actions.
        settings: an instance of the class's `settings_class`.
        beta: for a class with `tunes_beta`.
        ensemble: for a class with `uses_ensemble`.

    Raises:
        BadInput: there is no such model.
    """
    return construct(class_of(name), normalization, settings, beta, ensemble)


def construct(
    model: type[Model[Any]],
    normalization: Normalization,
    settings: Any,
    beta: float | None = None,
    ensemble: RnnEnsemble | None = None,
) -> Model[Any]:
    """A new model of a class. See `build` for the other arguments."""
    arguments: dict[str, Any] = {}
    if model.tunes_beta:
        arguments["beta"] = beta
    if model.uses_ensemble:
        arguments["ensemble"] = ensemble
    return model(normalization, settings, **arguments)


def fitted_ensemble(model: Model[Any]) -> RnnEnsemble | None:
    """The ensemble inside a model with `uses_ensemble`; None for other models."""
    ensemble = model.ensemble if model.uses_ensemble else None
    assert ensemble is None or isinstance(ensemble, RnnEnsemble)
    return ensemble


def save_model(model: Model[Any], name: str, path: Path, beta: float | None = None) -> None:
    """Write a model. The file is self-contained: it also holds the ensemble of a residual model.

    With the weights go the versions, the device, the compiler and the threads of this process.

    Args:
        model: the model.
        name: see `class_of`.
        path: of the file.
        beta: the β of a class with `tunes_beta`.
    """
    ensemble = fitted_ensemble(model)
    facts = {
        "model": name,
        "settings": to_json(model.settings),
        "beta": beta,
        "ensemble_settings": None if ensemble is None else to_json(ensemble.settings),
        "runtime": runtime(),
    }
    tensors = {key: value.contiguous().cpu() for key, value in model.state_dict().items()}
    save_file(tensors, path, {"facts": json.dumps(facts, sort_keys=True)})


def load_model(path: Path) -> Model[Any]:
    """Read what `save_model` wrote, ready to forecast.

    Raises:
        StudyError: the file is missing or damaged, or another version of the study wrote it.
    """
    try:
        with safe_open(path, framework="np") as file:
            facts = json.loads(file.metadata()["facts"])
        tensors = load_file(path)
    except (OSError, SafetensorError, ValueError, KeyError, TypeError) as error:
        reason = " ".join(str(error).split())
        raise StudyError(f"{path} is missing or damaged ({reason})") from error
    try:
        arrays = [np.asarray(tensors[entry.name].numpy()) for entry in fields(Normalization)]
        normalization = Normalization(*arrays)
        ensemble = None
        if facts["ensemble_settings"] is not None:
            settings = from_json(RnnEnsemble.settings_class, facts["ensemble_settings"])
            ensemble = RnnEnsemble(normalization, settings)
        settings = from_json(class_of(facts["model"]).settings_class, facts["settings"])
        model = build(facts["model"], normalization, settings, facts["beta"], ensemble)
        model.load_state_dict(tensors)
    except (BadInput, KeyError, RuntimeError, TypeError, ValueError) as error:
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise StudyError(
            f"{path}: another version of the study wrote these weights of {facts['model']} "
            f"({reason}); run the study again, or use that version"
        ) from error
    return model.eval()
