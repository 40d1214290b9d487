"""A fitted model as one safetensors file: its weights, and what is needed to build it again."""

import json
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import safe_open
from safetensors.torch import load_file, save_file

from study.common.errors import StudyError
from study.data.normalization import Normalization
from study.models import Model, models
from study.models.rnn_ensemble import Ensemble


def build(
    name: str,
    normalization: Normalization,
    settings: dict[str, Any],
    beta: float | None = None,
    ensemble: Ensemble | None = None,
) -> Model:
    """A new model of the registered class `name`, or an `Ensemble`."""
    if name == "ensemble":
        return Ensemble(normalization, settings)
    model = models[name]
    extra: dict[str, Any] = {}
    if model.tunes_beta:
        extra["beta"] = beta
    if model.uses_ensemble:
        extra["ensemble"] = ensemble
    return model(normalization, settings, **extra)


def save_model(model: Model, name: str, path: Path, beta: float | None = None) -> None:
    """Write a model. The file is complete in itself: a residual VAE's holds its ensemble, too."""
    ensemble = getattr(model, "ensemble", None)
    facts = {
        "model": name,
        "settings": model.settings,
        "beta": beta,
        "ensemble_settings": ensemble.settings if isinstance(ensemble, Ensemble) else None,
    }
    tensors = {key: value.contiguous().cpu() for key, value in model.state_dict().items()}
    save_file(tensors, path, {"facts": json.dumps(facts, sort_keys=True)})


def load_model(path: Path) -> Model:
    """Read what `save_model` wrote, ready to forecast.

    Raises:
        StudyError: the file is of a version of the study whose model was another.
    """
    with safe_open(path, framework="np") as file:
        facts = json.loads(file.metadata()["facts"])
    tensors = load_file(path)
    names = (
        "state_mean",
        "state_scale",
        "action_mean",
        "action_scale",
        "delta_std",
        "rotating_pairs",
    )
    normalization = Normalization(*(np.asarray(tensors[name].numpy()) for name in names))
    ensemble = (
        Ensemble(normalization, facts["ensemble_settings"]) if facts["ensemble_settings"] else None
    )
    try:
        model = build(facts["model"], normalization, facts["settings"], facts["beta"], ensemble)
        model.load_state_dict(tensors)
    except (KeyError, RuntimeError) as error:
        raise StudyError(
            f"{path}: weights of a {facts['model']} of another version of the study; run the study "
            "again, or use the version that made them"
        ) from error
    return model.eval()
