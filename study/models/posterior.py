"""A fitted VAE on observed data: whether it uses its latent variable, and the ELBO.

In a *collapsed* posterior, q_φ(z_t | ·) is the prior N(0, I) for every input. Then z_t carries no
information, and the decoder ignores z_t. The noise of a step is that of p_θ alone, so the VAE is a
Gaussian model with memory.
"""

from typing import TYPE_CHECKING

import torch
from torch import Tensor

from study.models.networks.cvae import kl_from_standard_normal
from study.models.networks.likelihood import gaussian_nll
from study.models.sampling import repeat_samples

if TYPE_CHECKING:
    from study.models.vae import VaeModel

ACTIVE_ABOVE = 0.01
"""Variance of a component's posterior mean, above which the component is an active unit."""

TRAJECTORIES, STEPS, SAMPLES = 64, 8, 8
"""Sizes of the estimate of `latent_share`: at most so many trajectories, evenly spaced steps of
each, and samples of z_t at each step."""


@torch.no_grad()
def posterior_statistics(model: "VaeModel", batch: dict[str, Tensor]) -> dict[str, float]:
    """Statistics of the posterior of a fitted VAE.

    Active units alone can mislead. The posterior mean may vary while the decoder ignores it. So
    `latent_share` measures what the decoder does with z_t.

    Args:
        model: the VAE.
        batch: observed trajectories, see `Model.diagnostics`.

    Returns:
        kl: E KL[q_φ(z_t | ·) ‖ N(0, I)], in nats a step.
        active_units: the number of components with Var(E_q[z]) > 0.01 over trajectories and steps
            (Burda, Grosse and Salakhutdinov, ICLR 2016).
        latent_share: see `latent_share`.
    """
    states, baseline, condition = observed(model, batch)
    mean, log_variance = encode(model, states, baseline, condition)
    share = latent_share(model, states, baseline, condition, mean, log_variance)
    return {
        "kl": float(kl_from_standard_normal(mean, log_variance).mean()),
        "active_units": float((mean.flatten(0, 1).var(0) > ACTIVE_ABOVE).sum()),
        "latent_share": share,
    }


@torch.no_grad()
def negative_elbo(model: "VaeModel", batch: dict[str, Tensor]) -> float:
    """The negative evidence lower bound of observed trajectories, averaged over them and over t.

        E_q[−log p_θ(s_{t+1} | ·)] + KL[q_φ(z_t | ·) ‖ N(0, I)]

    The terms are those of equation (12) with β = 1, without the weights of `heteroscedastic_nll`,
    and with the σ² of forecasts. z_t has one sample, the same in every call.

    Args:
        model: the VAE.
        batch: observed trajectories, see `Model.diagnostics`.

    Returns:
        nats a step, summed over the dimensions of the normalised state.
    """
    states, baseline, condition = observed(model, batch)
    mean, log_variance = encode(model, states, baseline, condition)
    latent = sample(mean, log_variance, torch.Generator().manual_seed(0))
    history = states[:, :-1] if is_teacher_forced(model) else None
    means, log_std = model.cvae.decode(states[:, 0], baseline, condition, latent, history)
    log_variance_of_state = model.cvae.decoder.variance.log() + 2 * log_std
    square = (states[:, 1:] - means).square() / log_variance_of_state.exp()
    nll = gaussian_nll(square, log_variance_of_state).sum(-1)
    return float((nll + kl_from_standard_normal(mean, log_variance)).mean())


def observed(model: "VaeModel", batch: dict[str, Tensor]) -> tuple[Tensor, Tensor, Tensor]:
    """States and baselines [B, T+1, D] and conditions [B, T, C] of observed trajectories.

    Every member of the ensemble in turn, so that no random number is needed.

    Args:
        model: the VAE.
        batch: see `validation_trajectories`.
    """
    states, actions = batch["states"], batch["actions"]
    baselines = model.baselines(states[:, 0], actions, batch.get("members"))
    member = torch.arange(len(states), device=states.device)[:, None] % baselines.shape[1]
    return states, *model.select(baselines, actions, member)


def encode(
    model: "VaeModel", states: Tensor, baseline: Tensor, condition: Tensor
) -> tuple[Tensor, Tensor]:
    """Mean and log variance of q_φ(z_t | ·), [B, T, Z] each.

    Args:
        model: the VAE.
        states: s_{0:T} [B, T+1, D].
        baseline: b_{0:T} [B, T+1, D].
        condition: c_{0:T-1} [B, T, C].
    """
    target = states[:, 1:] - baseline[:, 1:]
    return model.cvae.encode(target, states[:, :-1], condition)


def is_teacher_forced(model: "VaeModel") -> bool:
    """Whether the decoder's state history is the true states at the end of training."""
    return model.is_teacher_forced(model.settings.train.steps)


def sample(mean: Tensor, log_variance: Tensor, generator: torch.Generator) -> Tensor:
    """z_t ~ N(μ, ν) [B, T, Z]. The generator is of the CPU, so all devices have equal samples."""
    normal = torch.randn(mean.shape, generator=generator).to(mean.device)
    return mean + normal * torch.exp(0.5 * log_variance)


def latent_share(
    model: "VaeModel",
    states: Tensor,
    baseline: Tensor,
    condition: Tensor,
    mean: Tensor,
    log_variance: Tensor,
) -> float:
    """The share of the one-step variance that comes from z_t, averaged over dimensions.

        E Var_z[ŝ_{t+1}] / (E Var_z[ŝ_{t+1}] + E σ²_{t+1}),   z_t ~ N(0, I)

    where σ² is the variance of p_θ, and the history is the same for all z_t: the observed states,
    and z_{0:t-1} from q_φ. The share is 0 if the decoder ignores z_t, and 1 if p_θ has no noise.

    Args:
        model: the VAE.
        states: s_{0:T} [B, T+1, D].
        baseline: b_{0:T} [B, T+1, D].
        condition: c_{0:T-1} [B, T, C].
        mean, log_variance: of q_φ(z_t | ·), [B, T, Z].
    """
    generator = torch.Generator().manual_seed(0)
    latent = sample(mean, log_variance, generator)
    rows = torch.arange(0, len(states), -(-len(states) // TRAJECTORIES), device=states.device)
    states, baseline, condition, latent = (
        repeat_samples(values[rows], SAMPLES) for values in (states, baseline, condition, latent)
    )
    from_latent, from_noise = torch.zeros(2, states.shape[-1], device=states.device)
    horizon = mean.shape[1]
    for step in sorted({int(t) for t in torch.linspace(0, horizon - 1, STEPS)}):
        prior = torch.randn(len(latent), latent.shape[-1], generator=generator).to(mean.device)
        means, variances = one_step(model, step, states, baseline, condition, latent, prior)
        from_latent += means.unflatten(0, (-1, SAMPLES)).var(1).mean(0)
        from_noise += variances.mean(0)
    return float((from_latent / (from_latent + from_noise)).mean())


def one_step(
    model: "VaeModel",
    step: int,
    states: Tensor,
    baseline: Tensor,
    condition: Tensor,
    latent: Tensor,
    latent_at_step: Tensor,
) -> tuple[Tensor, Tensor]:
    """Mean ŝ_{t+1} and variance σ²_{t+1} of p_θ for another z_t, [B, D] each.

    The state history is that of the model's training: observed states, or its own predictions.

    Args:
        model: the VAE.
        step: t.
        states, baseline, condition: see `latent_share`.
        latent: z_{0:T-1} [B, T, Z].
        latent_at_step: z_t [B, Z].
    """
    latent = torch.cat([latent[:, :step], latent_at_step[:, None]], 1)
    history = states[:, : step + 1] if is_teacher_forced(model) else None
    means, log_std = model.cvae.decode(
        states[:, 0], baseline[:, : step + 2], condition[:, : step + 1], latent, history
    )
    return means[:, -1], model.cvae.decoder.variance * torch.exp(2 * log_std[:, -1])
