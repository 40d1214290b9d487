"""Small models on random data."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from study.config.model_sections import Crps, Mlp, ModelEnsemble, Vae
from study.config.settings import SECTIONS, Config, Ensemble
from study.data.normalization import Normalization
from study.data.trajectories import Trajectories
from study.models import Model, models
from study.models.checkpoints import build, class_of
from study.models.rnn_ensemble import RnnEnsemble

OURS = [name for name in models if models[name].__module__.startswith("study.models.")]
"""The study's own models: other tests register models of their own."""

STATE, ACTION, HORIZON = 3, 2, 6
MEMBERS = 3
SMALL = Config(
    ensemble=Ensemble(members=MEMBERS, hidden_size=8),
    sections={
        "vae": Vae(hidden_size=8, latent_size=4),
        "crps": Crps(hidden_size=8, noise_size=3, trajectory_latent_size=2),
        "mlp": Mlp(hidden_size=8, layers=2),
        "model_ensemble": ModelEnsemble(members=MEMBERS),
    },
)


def trajectories(count: int = 12, seed: int = 0) -> Trajectories:
    generator = np.random.default_rng(seed)
    actions = generator.normal(size=(count, HORIZON, ACTION)).astype(np.float32)
    changes = generator.normal(size=(count, HORIZON + 1, STATE)) * [1.0, 5.0, 0.1] + 1.0
    states = changes.cumsum(axis=1).astype(np.float32)
    empty = np.zeros((count, 0), np.float32)
    return Trajectories(states, actions, empty, empty, {})


def normalization() -> Normalization:
    return Normalization.from_trajectories(trajectories())


def settings(name: str, **changes: Mapping[str, Any]) -> Any:
    """The settings of a small model.

    Args:
        name: of the model.
        changes: values of a section, by the name of the section.
    """
    changed = {
        section: replace(SMALL.section(section), **values) for section, values in changes.items()
    }
    core = {section: values for section, values in changed.items() if section in SECTIONS}
    config = replace(SMALL, **core, sections={**SMALL.sections, **changed})
    return class_of(name).settings_from(config, name)


def ensemble() -> RnnEnsemble:
    return RnnEnsemble(normalization(), settings("ensemble"))


def model(name: str, **changes: Mapping[str, Any]) -> Model:
    """A small model with initial weights; arguments as of `settings`."""
    torch.manual_seed(0)
    fitted = ensemble()
    return build(name, normalization(), settings(name, **changes), 0.1, fitted)


def batch(count: int = 8, seed: int = 2) -> dict[str, Tensor]:
    """A training batch of random trajectories."""
    data, units = trajectories(count, seed), normalization()
    return {
        "states": units.normalize_states(data.states),
        "actions": units.normalize_actions(data.actions),
    }
