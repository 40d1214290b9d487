"""Tutorial, part two: a model. Each step adds a learned constant and Gaussian noise to the state.

A model joins the study by the decorator `models.register`. ``--plugins '[study.examples.drift]'``
imports this file, and ``--grid.models '[drift]'`` fits and scores the model.

The model ignores the actions. So its scores show what a model gains by using them.
"""

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from study.config.sections import setting
from study.config.settings import Train
from study.data.normalization import Normalization
from study.models import Model, models


@dataclass(frozen=True)
class DriftSettings:
    """What the model reads of the configuration.

    A field whose type is a dataclass is a section, by its name. Every other field is a setting of
    the model's own: ``--model.drift.initial_std 0.2``, with the bounds that are given here.

    Args:
        train: how the model is trained.
        initial_std: σ before training, normalised.
    """

    train: Train
    initial_std: float = setting(0.1, low=1e-6, high=10.0)


@models.register("drift")
class Drift(Model[DriftSettings]):
    """A random walk with drift, s_{t+1} = s_t + μ + σ ε_t, with learned μ and σ.

    Args:
        normalization: moments of the training data. States and actions arrive normalised, so the
            model needs no scales of its own.
        settings: what the model reads of the configuration.
    """

    settings_class = DriftSettings

    def __init__(self, normalization: Normalization, settings: DriftSettings) -> None:
        super().__init__(normalization, settings)
        # Standard normal numbers that `sample` gets for each time step.
        self.noise_size = self.state_size
        self.mean = nn.Parameter(torch.zeros(self.state_size))
        self.std = nn.Parameter(torch.full((self.state_size,), settings.initial_std))

    def losses(self, batch: dict[str, Tensor], step: int) -> dict[str, Tensor]:
        """The loss of a batch of training trajectories; `step` counts optimiser steps.

        ``batch["states"]`` is [B, T+1, D]. Other entries of the dictionary are logged as curves.
        """
        states = batch["states"]
        error = states[:, 1:] - states[:, :-1] - self.mean
        std_error = error.detach().std() - self.std
        return {"loss": error.square().mean() + std_error.square().mean()}

    def sample(self, s0: Tensor, actions: Tensor, noise: Tensor, member: Tensor) -> Tensor:
        """Sample K trajectories of each scenario.

        Args:
            s0: [S, D], normalised.
            actions: [S, T, A], normalised.
            noise: [S, K, T, noise_size], standard normal. The noise is an argument, so that a
                forecast depends on its seed alone.
            member: [S, K], a member of an ensemble for each sample; this model has none.

        Returns:
            [S, K, T, D], normalised states s_1 … s_T.
        """
        return s0[:, None, None] + torch.cumsum(self.mean + self.std * noise, dim=2)
