"""The probabilistic MLP (section III-C; Kendall and Gal 2017; Chua et al. 2018)."""

from dataclasses import dataclass
from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn import functional

from study.config.model_sections import Mlp
from study.config.settings import Train
from study.data.normalization import Normalization
from study.models.base import Model, models
from study.models.networks.likelihood import beta_nll_weights, gaussian_nll
from study.models.sampling import repeat_samples

BOUNDS_WEIGHT = 0.01
"""Weight of the variance bounds in the loss (Chua et al. 2018, appendix A.1)."""


@dataclass(frozen=True)
class MlpSettings:
    """Settings of a probabilistic MLP."""

    mlp: Mlp
    train: Train


@models.register("probabilistic_mlp")
class ProbabilisticMlp(Model[MlpSettings]):
    """s_{t+1} ~ N(s_t + δ μ(s_t, a_t), δ² σ²(s_t, a_t)), sampled and fed back.

    δ is the standard deviation of a state's change over one step. For some components it is
    hundreds of times smaller than the standard deviation of the state, so the network's output is
    in units of δ. log σ² has soft bounds, as in Chua et al.
    """

    settings_class = MlpSettings

    def __init__(self, normalization: Normalization, settings: MlpSettings) -> None:
        super().__init__(normalization, settings)
        self.noise_size = self.state_size
        hidden_size, layers = settings.mlp.hidden_size, settings.mlp.layers
        sizes = [self.state_size + self.action_size, *[hidden_size] * layers]
        stack: list[nn.Module] = []
        for inputs, outputs in pairwise(sizes):
            stack += [nn.Linear(inputs, outputs), nn.SiLU()]
        self.network = nn.Sequential(*stack, nn.Linear(hidden_size, 2 * self.state_size))
        self.max_log_variance = nn.Parameter(torch.full((self.state_size,), 1.0))
        self.min_log_variance = nn.Parameter(torch.full((self.state_size,), -12.0))

    def forward(self, state: Tensor, action: Tensor) -> tuple[Tensor, Tensor]:
        """Mean μ and log variance log σ² of (s_{t+1} − s_t) / δ, each [..., D].

        Args:
            state: s_t [..., D].
            action: a_t [..., A].
        """
        mean, log_variance = self.network(torch.cat([state, action], -1)).chunk(2, dim=-1)
        highest, lowest = self.max_log_variance, self.min_log_variance
        log_variance = highest - functional.softplus(highest - log_variance)
        log_variance = lowest + functional.softplus(log_variance - lowest)
        return mean, log_variance

    def losses(self, batch: dict[str, Tensor], step: int) -> dict[str, Tensor]:
        """See `Model.losses`: −log p(s_{t+1} | s_t, a_t), averaged over transitions."""
        states = batch["states"]
        mean, log_variance = self(states[:, :-1], batch["actions"])
        change = (states[:, 1:] - states[:, :-1]) / self.delta_std
        squares = (change - mean).square() * torch.exp(-log_variance)
        nll = gaussian_nll(squares, log_variance)
        if self.settings.mlp.loss == "beta_nll":
            nll = beta_nll_weights(0.5 * log_variance) * nll
        likelihood = nll.sum(-1).mean()
        # This term moves the bounds towards the variances of the data.
        bounds = self.max_log_variance.sum() - self.min_log_variance.sum()
        loss = likelihood + BOUNDS_WEIGHT * bounds
        return {"loss": loss, "loss/negative_log_likelihood": likelihood}

    def sample(self, s0: Tensor, actions: Tensor, noise: Tensor, member: Tensor) -> Tensor:
        """See `Model.sample`: ancestral sampling, step by step."""
        samples = member.shape[1]
        state, states = repeat_samples(s0, samples), []
        steps = zip(
            repeat_samples(actions, samples).unbind(1), noise.flatten(0, 1).unbind(1), strict=True
        )
        for action, normal in steps:
            state = self.step(state, action, normal)
            states.append(state)
        return torch.stack(states, dim=1).unflatten(0, (-1, samples))

    def step(self, state: Tensor, action: Tensor, normal: Tensor) -> Tensor:
        """A sample of s_{t+1} [..., D].

        Args:
            state: s_t [..., D].
            action: a_t [..., A].
            normal: standard normal numbers [..., D].
        """
        mean, log_variance = self(state, action)
        change = mean + torch.exp(0.5 * log_variance) * normal
        return state + change * self.delta_std
