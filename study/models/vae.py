"""What the residual VAE and the full VAE share: how the recurrent CVAE is fitted and sampled."""

from typing import Any

import torch
from torch import Tensor

from study.data.normalization import Normalization
from study.models.base import each_sample
from study.models.baseline import OnBaseline
from study.models.networks.cvae import RecurrentCvae

# With feeding `schedule`, this share of the steps is taught with the true states.
TAUGHT = 0.3

# Share of the last batch in the running mean that is σ².
RENEWED = 0.05


class Vae(OnBaseline):
    """A recurrent conditional VAE on a baseline; a subclass says which baseline.

    Args:
        normalization: standard units.
        settings: the sections `vae` and `train` of the configuration.
        beta: β of equation (12).
        extra_conditions: size of what the decoder sees beside the actions.
    """

    tunes_beta = True
    sections = ("vae", "train")

    def __init__(
        self,
        normalization: Normalization,
        settings: dict[str, Any],
        beta: float,
        extra_conditions: int = 0,
    ) -> None:
        super().__init__(normalization, settings)
        vae = settings["vae"]
        self.beta, self.feeding, self.draws = (
            beta,
            vae["teacher_forcing"],
            vae["decoder_output"] == "sample",
        )
        self.latent_size = int(vae["latent_size"])
        self.noise_size = self.latent_size + (self.state_size if self.draws else 0)
        increments = vae["target"] == "delta"
        self.cvae = RecurrentCvae(
            self.delta_std if increments else torch.ones_like(self.delta_std),
            self.action_size + extra_conditions,
            vae["hidden_size"],
            self.latent_size,
            increments=increments,
            one_width=vae["variance"] == "homoscedastic",
            sees_target=vae["encoder"] == "target",
        )

    def draw_training_members(self, count: int, device: torch.device) -> Tensor:
        """m [B] for a training batch (Algorithm 1, line 4)."""
        size = 1 if self.settings["vae"]["member"] == "batch" else count
        return torch.randint(self.members_count(), (size,), device=device).expand(count)

    def is_taught(self, step: int) -> bool:
        """Whether the decoder is now fed the true states instead of its own predictions."""
        if self.feeding != "scheduled":
            return self.feeding == "always"
        return bool(step < TAUGHT * self.settings["train"]["steps"])

    def losses(self, batch: dict[str, Tensor], step: int) -> dict[str, Tensor]:
        """One batch of Algorithm 1."""
        states, actions = batch["states"], batch["actions"]
        s0, truth = states[:, 0], states[:, 1:]
        member = self.draw_training_members(len(s0), s0.device)
        baseline, condition = self.conditions(s0, actions, member[:, None], batch.get("members"))
        target = truth - baseline[:, 1:]  # ε_alea = y_true − ŷ_m, equation (7)
        mean, log_variance = self.cvae.encode(target, states[:, :-1], condition)
        latent = mean + torch.randn_like(mean) * torch.exp(0.5 * log_variance)
        history = states[:, :-1] if self.is_taught(step) else None
        given = (s0, baseline, condition, latent, history)
        prediction, log_width = self.cvae.decode.distribution(*given)
        loss, likelihood, divergence, variance = self.cvae.loss(
            truth - prediction, log_width, mean, log_variance, self.beta
        )
        self.cvae.decode.remember(variance, max(RENEWED, 1 / (step + 1)))
        return {"loss": loss, "loss/negative_log_likelihood": likelihood, "loss/kl": divergence}

    def sample(self, s0: Tensor, actions: Tensor, noise: Tensor, member: Tensor) -> Tensor:
        """See `Model.sample`: z_t from the prior, s_{t+1} from p_θ(s_{t+1} | ·) or its mean.

        A decoder that was taught with true states, noise and all, is fed what was drawn; one that
        learned from its own predictions is fed those.
        """
        return self.generate(s0, actions, noise, member, None)

    def generate(
        self, s0: Tensor, actions: Tensor, noise: Tensor, member: Tensor, members: Tensor | None
    ) -> Tensor:
        """As `sample`, with the ensemble's forecasts [S, M, T, D] where they are at hand."""
        samples = member.shape[1]
        baseline, condition = self.conditions(s0, actions, member, members)
        latent, normal = noise.flatten(0, 1).split_with_sizes(
            [self.latent_size, self.noise_size - self.latent_size], dim=-1
        )
        given = (each_sample(s0, samples), baseline, condition, latent)
        decode = self.cvae.decode
        if not self.draws:
            forecasts = decode(*given)
        elif self.feeding == "always":
            forecasts = decode.draw(*given, normal)
        else:
            mean, log_width = decode.distribution(*given)
            forecasts = mean + decode.variance.sqrt() * torch.exp(log_width) * normal
        return forecasts.unflatten(0, (-1, samples))
