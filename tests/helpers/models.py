"""Small models on random data."""

from dataclasses import asdict
from typing import Any

import numpy as np
import torch

from study.config.settings import (
    Config,
    Crps,
    Ensemble,
    Mlp,
    ModelEnsemble,
    ProbabilisticEnsemble,
    Vae,
)
from study.data.normalization import Normalization
from study.data.trajectories import Trajectories
from study.models import Model
from study.models.checkpoints import build

STATE, ACTION, HORIZON = 3, 2, 6


def trajectories(count: int = 12, seed: int = 0) -> Trajectories:
    generator = np.random.default_rng(seed)
    actions = generator.normal(size=(count, HORIZON, ACTION)).astype(np.float32)
    changes = generator.normal(size=(count, HORIZON + 1, STATE)) * [1.0, 5.0, 0.1] + 1.0
    states = changes.cumsum(axis=1).astype(np.float32)
    nothing = np.zeros((count, 0), np.float32)
    return Trajectories(states, actions, nothing, nothing, {})


def settings(
    propagation: str = "trajectory", crps: dict[str, Any] | None = None, **vae: Any
) -> dict[str, Any]:
    return {
        "vae": asdict(Vae(hidden_size=8, latent_size=4, **vae)),
        "crps": asdict(Crps(hidden_size=8, noise_size=5, persistent_noise_size=2, **(crps or {}))),
        "mlp": asdict(Mlp(hidden_size=8, layers=2)),
        "model_ensemble": asdict(ModelEnsemble(members=3)),
        "probabilistic_ensemble": asdict(ProbabilisticEnsemble(propagation)),
        "train": asdict(Config().train),
        "ensemble": asdict(Ensemble(members=3, hidden_size=8)),
    }


def model(name: str, beta: float = 0.1, **vae: Any) -> Model:
    torch.manual_seed(0)
    normalization = Normalization.of(trajectories())
    ensemble: Any = build("ensemble", normalization, settings())
    return build(name, normalization, settings(**vae), beta, ensemble)
