"""Models and data of the sizes that the benchmarks are about."""

from dataclasses import asdict, replace
from typing import Any

import torch

from study.common.progress import Progress
from study.config.settings import Config, Ensemble, Mlp, Vae
from study.data.normalization import Normalization
from study.data.trajectories import Trajectories, joined
from study.envs import simulators
from study.envs.observe import observe_trajectories
from study.models import Model
from study.models.checkpoints import build

MODELS = ("ensemble", "residual_vae", "full_vae", "probabilistic_mlp")
SIZES = {
    "quick": Config(),
    "paper": Config(
        ensemble=Ensemble(hidden_size=128), vae=Vae(hidden_size=128), mlp=Mlp(hidden_size=256)
    ),
}
"""Configurations with the widths of ``configs/quick.yaml`` and ``configs/paper.yaml``."""


def observe(environment: str, count: int, horizon: int | None = None) -> Trajectories:
    """Trajectories of an environment."""
    simulator = simulators[environment](horizon=horizon)
    return joined(observe_trajectories(simulator, count, 0, Progress()))


def built(name: str, config: Config, data: Trajectories) -> Model:
    """A model as it is before training, that never forces its networks with true states."""
    free = replace(
        config,
        ensemble=replace(config.ensemble, teacher_forcing_fraction=0.0),
        vae=replace(config.vae, teacher_forcing="never"),
    )
    sections: dict[str, Any] = {
        section: asdict(getattr(free, section)) for section in ("ensemble", "vae", "mlp", "train")
    }
    torch.manual_seed(0)
    normalization = Normalization.of(data)
    ensemble: Any = build("ensemble", normalization, sections)
    if name == "ensemble":
        return ensemble
    return build(name, normalization, sections, 1.0, ensemble)
