"""The probabilistic MLP (section III-C; Kendall and Gal 2017; Chua et al. 2018)."""

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.distributions import Normal

from study.config.model_sections import Mlp, Network
from study.config.settings import Train
from study.data.normalization import Normalization
from study.models.base import Model, models
from study.models.networks.architecture import Architecture
from study.models.networks.gaussian import GaussianDynamics
from study.models.sampling import repeat_samples


@dataclass(frozen=True)
class MlpSettings:
    """Settings of a probabilistic MLP."""

    mlp: Mlp
    network: Network
    train: Train


@models.register("probabilistic_mlp")
class ProbabilisticMlp(Model[MlpSettings]):
    """s_{t+1} ~ N(s_t + δ (μ(s_t, a_t) + s_0 R), σ²(s_t, a_t)), sampled and fed back.

    δ is the standard deviation of a state's change over one step. For some components it is
    hundreds of times smaller than the standard deviation of the state, so the network's output is
    in units of δ. The network is a `GaussianDynamics` without memory.
    """

    settings_class = MlpSettings

    def __init__(self, normalization: Normalization, settings: MlpSettings) -> None:
        super().__init__(normalization, settings)
        self.noise_size = self.state_size
        architecture = Architecture(
            inputs=self.action_size,
            width=settings.mlp.hidden_size,
            memory=False,
            product=settings.network.features == "product",
            layers=settings.mlp.layers - 1,
        )
        self.network = GaussianDynamics(normalization, architecture)

    def on_training_data(self, states: Tensor) -> None:
        """See `Model.on_training_data`: the network stores the range of the training states."""
        super().on_training_data(states)
        self.network.set_range(states)

    def losses(self, batch: dict[str, Tensor], step: int) -> dict[str, Tensor]:
        """See `Model.losses`: −log p(s_{t+1} | s_t, a_t), averaged over transitions."""
        states, weighted = batch["states"], self.settings.mlp.loss == "beta_nll"
        before, after = states[None, :, :-1], states[None, :, 1:]
        offset = torch.zeros_like(before)
        mean, log_std = self.network.predict(before, batch["actions"][None], offset)
        return {"loss": self.network.nll(after - mean, log_std, step, weighted)}

    def sample(self, s0: Tensor, actions: Tensor, noise: Tensor, member: Tensor) -> Tensor:
        """See `Model.sample`: ancestral sampling, step by step."""
        samples = member.shape[1]
        start, inputs = repeat_samples(s0, samples), repeat_samples(actions, samples)
        normal = noise.flatten(0, 1)
        rows = (start, inputs, torch.zeros_like(normal), normal)
        forecasts = self.network.sample_rollout(*(values[None] for values in rows))[0]
        return forecasts.unflatten(0, (-1, samples))

    def log_density(self, states: Tensor, actions: Tensor) -> Tensor:
        """See `study.models.log_score.HasDensity`: the sum over D independent normal densities."""
        before, after = states[None, :, :-1], states[None, :, 1:]
        mean, log_std = self.network.predict(before, actions[None], torch.zeros_like(before))
        std = self.network.variance.sqrt() * log_std.exp()
        return Normal(mean, std).log_prob(after).sum(-1)[0]

    def step(self, state: Tensor, action: Tensor, normal: Tensor, s0: Tensor) -> Tensor:
        """A sample of s_{t+1} [B, D].

        Args:
            state: s_t [B, D].
            action: a_t [B, A].
            normal: standard normal numbers [B, D].
            s0: [B, D].
        """
        rows = (state, action[:, None], torch.zeros_like(normal)[:, None], normal[:, None])
        sampled = self.network.sample_rollout(  # type: ignore[misc]
            *(values[None] for values in rows), start=s0[None]
        )
        return sampled[0, :, 0]
