"""Models and data at the sizes that the benchmarks measure."""

from dataclasses import replace
from typing import Any

import torch

from study.common.progress import Progress
from study.config.model_sections import Mlp, Vae
from study.config.settings import Config, Ensemble
from study.data.normalization import Normalization
from study.data.trajectories import Trajectories, concatenate
from study.envs import simulators
from study.envs.observe import observe_trajectories
from study.models import Model, models
from study.models.rnn_ensemble import RnnEnsemble

MODELS = ("ensemble", "residual_vae", "full_vae", "probabilistic_mlp")
SIZES = {
    "quick": Config(),
    "paper": Config(
        ensemble=Ensemble(hidden_size=128),
        sections={"vae": Vae(hidden_size=128), "mlp": Mlp(hidden_size=256)},
    ),
}
"""Configurations with the hidden sizes of ``configs/quick.yaml`` and ``configs/paper.yaml``."""


def observe(environment: str, count: int, horizon: int | None = None) -> Trajectories:
    """Trajectories of an environment."""
    simulator = simulators[environment](horizon=horizon)
    return concatenate(observe_trajectories(simulator, count, 0, Progress()))


def build_model(name: str, config: Config, data: Trajectories) -> Any:
    """A model with initial weights, that is never teacher forced.

    Args:
        name: of `MODELS`.
        config: its settings.
        data: gives the normalization and the range of the states.
    """
    torch.manual_seed(0)
    normalization = Normalization.from_trajectories(data)
    config = replace(
        config,
        ensemble=replace(config.ensemble, teacher_forcing_fraction=0.0),
        sections={
            **config.sections,
            "vae": replace(config.section("vae"), teacher_forcing="never"),
        },
    )
    ensemble = RnnEnsemble(normalization, RnnEnsemble.settings_from(config))
    states = normalization.normalize_states(data.states)
    ensemble.on_training_data(states)
    if name == "ensemble":
        return ensemble
    model: type[Model] = models[name]
    arguments: dict[str, Any] = {"beta": 1.0} if model.tunes_beta else {}
    if model.uses_ensemble:
        arguments["ensemble"] = ensemble
    built = model(normalization, model.settings_from(config, name), **arguments)
    built.on_training_data(states)
    return built
