"""Training and sampling of the recurrent CVAE, for the residual VAE and the full VAE."""

from dataclasses import dataclass

import torch
from torch import Tensor

from study.config.model_sections import Network, Vae
from study.config.settings import Train
from study.data.normalization import Normalization
from study.models.baseline import BaselineModel
from study.models.networks.architecture import Architecture
from study.models.networks.cvae import RecurrentCvae, kl_from_standard_normal
from study.models.posterior import negative_elbo, posterior_statistics
from study.models.sampling import repeat_samples

TEACHER_FORCING_FRACTION = 0.3
"""With `vae.teacher_forcing` at `scheduled`, the fraction of steps that are teacher forced."""


@dataclass(frozen=True)
class VaeSettings:
    """Settings of a VAE."""

    vae: Vae
    network: Network
    train: Train


class VaeModel(BaselineModel[VaeSettings]):
    """A recurrent conditional VAE that adds to a baseline. A subclass defines the baseline.

    Args:
        normalization, settings: see `Model`.
        beta: β of equation (12).
    """

    settings_class = VaeSettings
    tunes_beta = True

    def __init__(self, normalization: Normalization, settings: VaeSettings, beta: float) -> None:
        super().__init__(normalization, settings)
        vae = settings.vae
        self.beta = beta
        self.samples_output = vae.decoder_output == "sample"
        self.noise_size = vae.latent_size + (self.state_size if self.samples_output else 0)
        architecture = Architecture(
            inputs=self.condition_size() + vae.latent_size,
            width=vae.hidden_size,
            memory=True,
            start=self.condition_size(),
            product=settings.network.features == "product",
            delta=vae.target == "delta",
        )
        self.cvae = RecurrentCvae(
            normalization,
            architecture,
            vae.latent_size,
            homoscedastic=vae.variance == "homoscedastic",
            uses_target=vae.encoder == "target",
        )

    def on_training_data(self, states: Tensor) -> None:
        """See `Model.on_training_data`: the decoder stores the range of the training states."""
        super().on_training_data(states)
        self.cvae.decoder.set_range(states)

    def losses(self, batch: dict[str, Tensor], step: int) -> dict[str, Tensor]:
        """See `Model.losses`: one batch of Algorithm 1, with the loss of equation (12).

            −E_q[log p_θ(s_{t+1} | ε̂_{t+1} + ŝ^m_{t+1})] + β KL[q_φ(z_t | ·) ‖ p(z_t)]

        averaged over the batch and over t. Equation (11) has the sum over t: the mean scales both
        terms alike, so β means the same. The likelihood is weighted: see `heteroscedastic_nll`.
        """
        states, actions = batch["states"], batch["actions"]
        s0, truth = states[:, 0], states[:, 1:]
        baselines = self.baselines(s0, actions, batch.get("members"))
        member = self.sample_training_members(len(s0), baselines.shape[1], s0.device)
        baseline, condition = self.select(baselines, actions, member[:, None])
        target = truth - baseline[:, 1:]  # ε_alea = y_true − ŷ_m, equation (8)
        mean, log_variance = self.cvae.encode(target, states[:, :-1], condition)
        latent = mean + torch.randn_like(mean) * torch.exp(0.5 * log_variance)  # z_t ~ q_φ(z_t | ·)
        history = states[:, :-1] if self.is_teacher_forced(step) else None
        # ŷ_pred = ε̂_alea + ŷ_m, section III-B
        prediction, log_std = self.cvae.decode(s0, baseline, condition, latent, history)
        nll = self.cvae.decoder.nll(truth - prediction, log_std, step)
        divergence = kl_from_standard_normal(mean, log_variance).mean()
        loss = nll + self.beta * divergence
        return {"loss": loss, "loss/negative_log_likelihood": nll, "loss/kl": divergence}

    def diagnostics(self, batch: dict[str, Tensor]) -> dict[str, float]:
        """See `Model.diagnostics`: whether the latent variable is used."""
        return posterior_statistics(self, batch)

    def negative_elbo(self, batch: dict[str, Tensor]) -> float:
        """See `Model.negative_elbo`."""
        return negative_elbo(self, batch)

    def sample_training_members(self, count: int, members: int, device: torch.device) -> Tensor:
        """m ~ U{0 … M−1} of each trajectory of a batch, [B] (Algorithm 1, line 4).

        Args:
            count: B.
            members: M.
            device: of the result.
        """
        size = 1 if self.settings.vae.member == "batch" else count
        return torch.randint(members, (size,), device=device).expand(count)

    def is_teacher_forced(self, step: int) -> bool:
        """Whether the decoder's state history at this optimiser step is the true states."""
        if self.settings.vae.teacher_forcing == "scheduled":
            return step < TEACHER_FORCING_FRACTION * self.settings.train.steps
        return self.settings.vae.teacher_forcing == "always"

    def sample(self, s0: Tensor, actions: Tensor, noise: Tensor, member: Tensor) -> Tensor:
        """See `Model.sample`."""
        return self.generate(s0, actions, noise, member, None)

    def generate(
        self, s0: Tensor, actions: Tensor, noise: Tensor, member: Tensor, members: Tensor | None
    ) -> Tensor:
        """Forecasts with z_t ~ p(z_t), and s_{t+1} from p_θ(s_{t+1} | ·) or its mean.

        True states include noise. So the state history of a decoder that was trained on true states
        is its samples. The state history of any other decoder is its means, as in training.

        Args:
            s0, actions, noise, member: see `Model.sample`.
            members: ŷ_m [S, M, T, D], the ensemble's forecasts; None to compute them.

        Returns:
            [S, K, T, D]
        """
        samples = member.shape[1]
        baseline, condition = self.select(self.baselines(s0, actions, members), actions, member)
        latent_size = self.settings.vae.latent_size
        latent, normal = noise.flatten(0, 1).tensor_split([latent_size], dim=-1)
        inputs = (repeat_samples(s0, samples), baseline, condition, latent)
        if self.samples_output and self.settings.vae.teacher_forcing == "always":
            forecasts = self.cvae.sample(*inputs, normal)
        else:
            forecasts, log_std = self.cvae.decode(*inputs)
            if self.samples_output:
                std = self.cvae.decoder.variance.sqrt() * torch.exp(log_std)
                forecasts = forecasts + std * normal
        return forecasts.unflatten(0, (-1, samples))
