"""The probabilistic MLP (section III-C; Kendall and Gal 2017; Chua et al. 2018)."""

import math
from itertools import pairwise
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional

from study.data.normalization import Normalization
from study.models.base import Model, each_sample, models
from study.models.networks.likelihood import by_width


@models.register("probabilistic_mlp")
class ProbabilisticMlp(Model):
    """s_{t+1} ~ N(s_t + μ(s_t, a_t), σ²(s_t, a_t)), sampled and fed back.

    μ and σ are in units of the change from one step to the next, since some components change
    hundreds of times less in a step than they vary. log σ² is bounded softly, as in Chua et al.

    Args:
        normalization: standard units.
        settings: the sections `mlp` and `train` of the configuration.
    """

    version = 2
    sections = ("mlp", "train")

    def __init__(self, normalization: Normalization, settings: dict[str, Any]) -> None:
        super().__init__(normalization, settings)
        self.noise_size = self.state_size
        width, layers = settings["mlp"]["hidden_size"], settings["mlp"]["layers"]
        sizes = [self.state_size + self.action_size, *[width] * layers]
        stack: list[nn.Module] = []
        for inputs, outputs in pairwise(sizes):
            stack += [nn.Linear(inputs, outputs), nn.SiLU()]
        self.network = nn.Sequential(*stack, nn.Linear(width, 2 * self.state_size))
        self.highest = nn.Parameter(torch.full((self.state_size,), 1.0))
        self.lowest = nn.Parameter(torch.full((self.state_size,), -12.0))

    def forward(self, state: Tensor, action: Tensor) -> tuple[Tensor, Tensor]:
        """Mean and log variance of (s_{t+1} − s_t) / delta_std, each [..., D]."""
        mean, log_variance = self.network(torch.cat([state, action], -1)).chunk(2, dim=-1)
        log_variance = self.highest - functional.softplus(self.highest - log_variance)
        log_variance = self.lowest + functional.softplus(log_variance - self.lowest)
        return mean, log_variance

    def losses(self, batch: dict[str, Tensor], step: int) -> dict[str, Tensor]:
        """−log p(s_{t+1} | s_t, a_t), averaged over transitions, the wider ones counting more."""
        states = batch["states"]
        mean, log_variance = self(states[:, :-1], batch["actions"])
        change = (states[:, 1:] - states[:, :-1]) / self.delta_std
        squares = (change - mean).square() * torch.exp(-log_variance)
        each = 0.5 * (squares + log_variance + math.log(2 * math.pi))
        if self.settings["mlp"]["loss"] == "beta_nll":
            each = by_width(0.5 * log_variance) * each
        likelihood = each.sum(-1).mean()
        # Draws the bounds towards what the data need (Chua et al. 2018, appendix A.1).
        loss = likelihood + 0.01 * (self.highest.sum() - self.lowest.sum())
        return {"loss": loss, "loss/negative_log_likelihood": likelihood}

    def sample(self, s0: Tensor, actions: Tensor, noise: Tensor, member: Tensor) -> Tensor:
        """See `Model.sample`: ancestral sampling, one step at a time."""
        samples = member.shape[1]
        state, states = each_sample(s0, samples), []
        controls = each_sample(actions, samples).unbind(1)
        for action, draw in zip(controls, noise.flatten(0, 1).unbind(1), strict=True):
            state = self.step(state, action, draw)
            states.append(state)
        return torch.stack(states, dim=1).unflatten(0, (-1, samples))

    def step(self, state: Tensor, action: Tensor, draw: Tensor) -> Tensor:
        """A sample of s_{t+1} [..., D], from standard normal numbers [..., D]."""
        mean, log_variance = self(state, action)
        change = mean + torch.exp(0.5 * log_variance) * draw
        return state + change * self.delta_std
