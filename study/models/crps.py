"""Models trained by proper scores of their own forecasts, without an encoder and without β.

The expectation of a strictly proper score is minimal for the true distribution. So the score can be
the loss (Gneiting and Raftery, JASA 102, 2007, section 5; Pacchiardi et al., JMLR 25, 2024). Two
scores are used. The distribution F of one step has a known density, and the logarithmic score

    LS(F, y) = −log p_F(y)

The distribution of a whole trajectory can only be sampled. m autoregressive rollouts x of each
trajectory are scored against the observed trajectory y, which also teaches the dependence between
dimensions:

    CRPS(F, y) = E|x − y| − ½ E|x − x'|            of each dimension and step
    ES(F, y)   = E‖x − y‖ − ½ E‖x − x'‖            of each step: the joint state

Both are estimated without bias for any m ≥ 2 (the fair estimator: no pair of a sample with itself).
"""

import math
from dataclasses import dataclass, replace
from functools import partial

import torch
from torch import Tensor
from torch.optim import Optimizer
from torch.optim.lr_scheduler import LambdaLR, LRScheduler

from study.config.model_sections import Crps
from study.config.settings import Train
from study.data.normalization import Normalization
from study.models.baseline import BaselineModel
from study.models.networks.likelihood import weighted_log_score
from study.models.networks.transition import TransitionDecoder
from study.models.sampling import repeat_samples

MIN_SCORE = 1e-6
"""Smallest score, and smallest standard deviation: keeps logarithms finite."""

TRANSITIONS = 512
"""Transitions of one optimiser step."""

TRAJECTORIES = 12
"""Trajectories of one optimiser step on rollouts."""

ROLLOUT_RATE = 0.1
"""Peak of the learning rate for rollouts, as a fraction of the peak for single transitions."""

EVALUATIONS = 10
"""Evaluations of the validation score during training."""


def fair_score(forecasts: Tensor, observed: Tensor) -> Tensor:
    """Fair energy score of vectors; for vectors of length 1 it is the fair CRPS.

        1/m Σ_i ‖x_i − y‖ − 1/(2m(m − 1)) Σ_{i≠j} ‖x_i − x_j‖

    Args:
        forecasts: x [..., m, D], m ≥ 2.
        observed: y [..., D].

    Returns:
        [...]
    """
    samples = forecasts.shape[-2]
    to_observed = _norm(forecasts - observed[..., None, :]).mean(-1)
    first, second = torch.triu_indices(samples, samples, 1, device=forecasts.device)
    between_samples = _norm(forecasts[..., first, :] - forecasts[..., second, :]).mean(-1)
    return to_observed - 0.5 * between_samples


def _norm(vectors: Tensor) -> Tensor:
    """Euclidean norm over the last axis, with a finite gradient at zero."""
    if vectors.shape[-1] == 1:
        return vectors[..., 0].abs()
    return (vectors.square().sum(-1) + 1e-12).sqrt()


@dataclass(frozen=True)
class CrpsSettings:
    """Settings of a CRPS model."""

    crps: Crps
    train: Train


class CrpsModel(BaselineModel[CrpsSettings]):
    """A decoder on a baseline, driven by noise; a subclass chooses the baseline.

    The first components of the noise persist over the whole trajectory, for what is unobserved and
    constant (a payload). The others are sampled at every step.

    Training begins with single transitions, from which a contact of hundredths of a second can be
    learned. Rollouts follow, which teach what persists and how errors accumulate.
    """

    settings_class = CrpsSettings

    def __init__(self, normalization: Normalization, settings: CrpsSettings) -> None:
        super().__init__(normalization, settings)
        crps = settings.crps
        self.noise_size = crps.noise_size
        self.decoder = TransitionDecoder(
            normalization,
            self.condition_size(),
            crps.hidden_size,
            crps.noise_size,
            crps.persistent_noise_size,
        )

    @classmethod
    def training_options(cls, settings: CrpsSettings) -> Train:
        """See `Model.training_options`: steps, batch and learning rate of the section `crps`.

        Training never stops early. Early evaluations say little, since a model that has learned
        single transitions alone may have bad rollouts.
        """
        crps = settings.crps
        return replace(
            settings.train,
            steps=crps.steps,
            batch_size=crps.batch_size,
            learning_rate=crps.learning_rate,
            validate_every=max(1, crps.steps // EVALUATIONS),
            patience=crps.steps,
        )

    def on_training_data(self, states: Tensor) -> None:
        """See `Model.on_training_data`: forecasts keep to the range of the training states."""
        super().on_training_data(states)
        self.decoder.set_range(states)

    def first_rollout_step(self) -> int:
        """The first optimiser step that trains on rollouts."""
        return round(self.settings.crps.one_step_fraction * self.settings.crps.steps)

    def resets_optimizer_at(self, step: int) -> bool:
        """See `Model.resets_optimizer_at`: gradients of rollouts have another magnitude."""
        return step == self.first_rollout_step()

    def schedule(self, optimizer: Optimizer, learning_rate: float, steps: int) -> LRScheduler:
        """See `Model.schedule`: one cycle for single transitions, and a lower one for rollouts.

        Rollouts respond to a change of the weights far more than single transitions do.
        """
        cycles = partial(two_cycles, steps=steps, one_step_steps=self.first_rollout_step())
        return LambdaLR(optimizer, cycles)

    def losses(self, batch: dict[str, Tensor], step: int) -> dict[str, Tensor]:
        """See `Model.losses`."""
        on_rollouts = step >= self.first_rollout_step()
        if on_rollouts:
            batch = {name: values[:TRAJECTORIES] for name, values in batch.items()}
        states, actions = batch["states"], batch["actions"]
        baselines = self.baselines(states[:, 0], actions, batch.get("members"))
        losses = self.rollout_losses if on_rollouts else self.transition_losses
        return losses(states, actions, baselines)

    def transition_losses(
        self, states: Tensor, actions: Tensor, baselines: Tensor
    ) -> dict[str, Tensor]:
        """The logarithmic score of single transitions, and the error of their mean.

        The probability of a step of the horizon is proportional to 1 + the mean squared change of
        the state in units of δ. So rare events, such as a start from rest, are sampled more often.
        The persistent noise is left out: within one step it cannot be separated from the other.

        Args:
            states: [B, T+1, D].
            actions: [B, T, A].
            baselines: [B, M, T+1, D].
        """
        scale, horizon = self.delta_std, actions.shape[1]
        weights = 1 + (states.diff(dim=1) / scale).square().mean((0, 2))
        probabilities = weights.expand(len(states), -1).flatten()
        chosen = torch.multinomial(probabilities, TRANSITIONS, replacement=True)
        row, t = chosen // horizon, chosen % horizon
        member = torch.randint(baselines.shape[1], chosen.shape, device=chosen.device)
        baseline = torch.stack([baselines[row, member, t], baselines[row, member, t + 1]], 1)
        condition = self.condition(baseline, actions[row, t][:, None])[:, 0]
        baseline_change = baseline[:, 1] - baseline[:, 0]
        state, s0 = states[row, t], states[row, 0]
        mean, factor = self.decoder.transition(state, baseline_change, condition, s0)
        error = (states[row, t + 1] - state - baseline_change) / scale - mean
        score = weighted_log_score(error, factor.square().sum(1).clamp(min=MIN_SCORE**2))
        # The score may explain an error as noise; the logarithm of the squared error does not.
        error_of_mean = error.square().mean(0).clamp(min=MIN_SCORE**2).log().mean()
        return {
            "loss": score + error_of_mean,
            "loss/transitions": score,
            "loss/mean": error_of_mean,
        }

    def rollout_losses(
        self, states: Tensor, actions: Tensor, baselines: Tensor
    ) -> dict[str, Tensor]:
        """The scores of m autoregressive rollouts of each trajectory, each from a sampled member.

            E_d log E CRPS_d + weight · log E ES,   states of the ES in units of each E CRPS_d

        The gradient of a logarithm is relative. So each dimension counts in proportion to its own
        uncertainty.

        Args:
            states, actions, baselines: see `transition_losses`.
        """
        s0, truth, crps = states[:, 0], states[:, 1:], self.settings.crps
        shape = (len(s0), crps.samples)
        member = torch.randint(baselines.shape[1], shape, device=s0.device)
        noise = torch.randn(*shape, truth.shape[1], self.noise_size, device=s0.device)
        forecasts = self.generate(s0, actions, noise, member, baselines)
        forecasts = forecasts.movedim(1, 2)  # [B, T, m, D]
        by_dimension = fair_score(forecasts.movedim(-1, -2)[..., None], truth[..., None])
        by_dimension = by_dimension.mean((0, 1))
        loss = by_dimension.clamp(min=MIN_SCORE).log().mean()
        unit = by_dimension.detach().clamp(min=MIN_SCORE)
        energy_score = fair_score(forecasts / unit, truth / unit).mean()
        loss = loss + crps.energy_weight * energy_score.clamp(min=MIN_SCORE).log()
        return {
            "loss": loss,
            "loss/crps": by_dimension.mean(),
            "loss/energy_score": energy_score,
        }

    def sample(self, s0: Tensor, actions: Tensor, noise: Tensor, member: Tensor) -> Tensor:
        """See `Model.sample`."""
        return self.generate(s0, actions, noise, member, self.baselines(s0, actions, None))

    def generate(
        self, s0: Tensor, actions: Tensor, noise: Tensor, member: Tensor, baselines: Tensor
    ) -> Tensor:
        """Forecasts [S, K, T, D] on baselines that are already known.

        Args:
            s0, actions, noise, member: see `Model.sample`.
            baselines: of all members [S, M, T+1, D].
        """
        samples, persistent_size = member.shape[1], self.settings.crps.persistent_noise_size
        baseline, condition = self.select(baselines, actions, member)
        persistent = noise[:, :, :1, :persistent_size].expand(-1, -1, noise.shape[2], -1)
        noise = torch.cat([persistent, noise[..., persistent_size:]], dim=-1).flatten(0, 1)
        forecasts = self.decoder(repeat_samples(s0, samples), baseline, condition, noise)
        return forecasts.unflatten(0, (-1, samples))


def two_cycles(step: int, steps: int, one_step_steps: int) -> float:
    """The learning rate as a fraction of its peak: two cycles of a short rise and a cosine decay.

    Args:
        step: the optimiser step, from 0.
        steps: all steps.
        one_step_steps: steps of the first cycle, which trains on single transitions.
    """
    if step < one_step_steps:
        peak, part = 1.0, (step + 1) / (one_step_steps + 1)
    else:
        peak, part = ROLLOUT_RATE, (step - one_step_steps + 1) / (steps - one_step_steps + 1)
    return peak * min(1.0, part / 0.05) * max(0.5 * (1 + math.cos(math.pi * part)), 0.003)
