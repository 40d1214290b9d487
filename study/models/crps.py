"""Models trained by proper scores of their own forecasts, without β.

The expectation of a strictly proper score is minimal for the true distribution. So the score can be
the loss (Gneiting and Raftery, JASA 102, 2007, section 5; Pacchiardi et al., JMLR 25, 2024). Two
scores are used. The distribution F of one step has a known density, and the logarithmic score

    LS(F, y) = −log p_F(y)

The distribution of a whole trajectory can only be sampled. m autoregressive rollouts x of each
trajectory are scored against the observed trajectory y. The energy score also depends on the
correlation of the dimensions:

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

from study.config.model_sections import Crps, Network
from study.config.settings import Train
from study.data.normalization import Normalization
from study.models.baseline import BaselineModel
from study.models.networks.architecture import Architecture
from study.models.networks.generator import GeneratorDynamics
from study.models.networks.likelihood import projected_log_score, weighted_log_score
from study.models.networks.trajectory_encoder import TrajectoryEncoder
from study.models.sampling import repeat_samples

MIN_SCORE = 1e-6
"""Smallest score and smallest standard deviation. It keeps logarithms finite."""

TRANSITIONS = 512
"""Number of transitions of one optimiser step."""

TRAJECTORIES = 12
"""Number of trajectories of one optimiser step on rollouts."""

ROLLOUT_RATE = 0.1
"""Peak of the learning rate for rollouts, as a fraction of the peak for single transitions."""

WARM_UP_FRACTION = 0.3
"""Fraction of the steps on single transitions during which the KL divergence is weighted less."""

ACTION_SUM_SCALE = 0.1
"""Factor on the sum of past actions, which grows over the horizon."""

EVALUATIONS = 5
"""Number of evaluations of the validation score during training."""


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
    network: Network
    train: Train


class CrpsModel(BaselineModel[CrpsSettings]):
    """A decoder with noise inputs that adds to a baseline. A subclass defines the baseline.

    Inputs beside the state are the condition, the sum of all past actions, a latent variable ζ of
    the whole trajectory (`TrajectoryEncoder`), and, outside the canonical frame, s_0:

    - A controller that integrates an error, such as an autopilot's, depends on past set-points. The
      difference between their sum and the distance travelled is that integral.
    - A variable may return to its initial value (a wind to its mean), and the size of its
      fluctuations may depend on that value. With symmetries, trajectories are transformed at
      random, so s_0 does not identify a training trajectory.

    Training begins with single transitions, from which contacts of hundredths of a second can be
    learned. Rollouts follow, from which the growth of errors is learned.
    """

    settings_class = CrpsSettings

    def __init__(self, normalization: Normalization, settings: CrpsSettings) -> None:
        super().__init__(normalization, settings)
        crps = settings.crps
        latent_size = crps.trajectory_latent_size
        self.noise_size = latent_size + crps.noise_size
        # A baseline and s_0 are not turned, so the canonical frame leaves them out.
        has_baseline = self.condition_size() > self.action_size
        axis = len(normalization.axis) > 0
        self.is_canonical = crps.canonical_frame and axis and not has_baseline
        self.start_size = 0 if self.is_canonical else self.state_size
        condition_size = self.condition_size() + (self.action_size if crps.action_sum else 0)
        architecture = Architecture(
            inputs=condition_size + latent_size + self.start_size,
            width=crps.hidden_size,
            memory=False,
            linear_start=False,
            product=settings.network.features == "product",
            canonical=self.is_canonical,
        )
        self.decoder = GeneratorDynamics(
            normalization, architecture, crps.noise_size, latent_size + self.start_size
        )
        self.encoder = None
        if latent_size:
            inputs = 2 * self.state_size + condition_size
            self.encoder = TrajectoryEncoder(inputs, latent_size)

    @classmethod
    def training_options(cls, settings: CrpsSettings) -> Train:
        """See `Model.training_options`: what the section `crps` has in place of `train`.

        Training never stops early. A model that has learned only single transitions may have bad
        rollouts, so early validation scores do not predict the last one.
        """
        crps = settings.crps
        return replace(
            settings.train,
            steps=crps.steps,
            batch_size=crps.batch_size,
            learning_rate=crps.learning_rate,
            symmetries=crps.symmetries,
            validate_every=max(1, crps.steps // EVALUATIONS),
            patience=crps.steps,
        )

    def on_training_data(self, states: Tensor) -> None:
        """See `Model.on_training_data`: the decoder stores the range of the training states."""
        super().on_training_data(states)
        self.decoder.set_range(states)

    def first_rollout_step(self) -> int:
        """The first optimiser step that trains on rollouts."""
        return round(self.settings.crps.one_step_fraction * self.settings.crps.steps)

    def resets_optimizer_at(self, step: int) -> bool:
        """See `Model.resets_optimizer_at`: the gradients of rollouts differ in magnitude."""
        return step == self.first_rollout_step()

    def schedule(self, optimizer: Optimizer, learning_rate: float, steps: int) -> LRScheduler:
        """See `Model.schedule`: one cycle for single transitions, and a lower one for rollouts.

        A rollout responds to a change of the weights far more than a single transition does.
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
        if on_rollouts:
            return self.rollout_losses(states, actions, baselines)
        return self.transition_losses(states, actions, baselines, step)

    def transition_losses(
        self, states: Tensor, actions: Tensor, baselines: Tensor, step: int
    ) -> dict[str, Tensor]:
        """The logarithmic score of single transitions, and the error of their mean.

        The probability of a step of the horizon is proportional to 1 + the mean squared change of
        the state in units of δ. So rare events, such as a start from rest, are sampled more often.
        ζ is sampled from q_φ(ζ | the whole trajectory), and the weight of its KL divergence is
        large. So ζ represents what most steps of a trajectory have in common, and not the noise of
        a single step.

        Args:
            states: [B, T+1, D].
            actions: [B, T, A].
            baselines: [B, M, T+1, D].
            step: optimiser steps already taken.
        """
        scale, horizon = self.delta_std, actions.shape[1]
        weights = 1 + (states.diff(dim=1) / scale).square().mean((0, 2))
        probabilities = weights.expand(len(states), -1).flatten()
        sampled = torch.multinomial(probabilities, TRANSITIONS, replacement=True)
        row, t = sampled // horizon, sampled % horizon
        # m ~ U{0 … M−1}, Algorithm 1, line 4
        member = torch.randint(baselines.shape[1], (len(states),), device=states.device)
        baseline, condition = self.select(baselines, actions, member[:, None])
        latent, divergence = self.encode(states, condition, step)
        inputs = torch.cat([condition[row, t], latent[row], states[row, 0, : self.start_size]], -1)
        state, change = states[row, t], baseline[row, t + 1] - baseline[row, t]
        change = (states[row, t + 1] - state - change) / scale
        transition = self.decoder.transition(state[None], inputs[None], change[None])
        error, factor = (values[0] for values in transition)
        score = weighted_log_score(error, factor.square().sum(1).clamp(min=MIN_SCORE**2))
        correlation = projected_log_score(error, factor)
        # A large variance can lower the score of a large error, but not its squared error.
        error_of_mean = error.square().mean(0).clamp(min=MIN_SCORE**2).log().mean()
        weight = self.latent_weight(step) / states[0, 1:].numel()
        return {
            "loss": score + correlation + error_of_mean + weight * divergence,
            "loss/transitions": score,
            "loss/correlation": correlation,
            "loss/mean": error_of_mean,
            "loss/kl": divergence,
        }

    def latent_weight(self, step: int) -> float:
        """The weight of the KL divergence of ζ, which rises linearly at first.

        With the full weight from the start, the posterior may collapse before ζ has an effect.
        """
        warm_up = WARM_UP_FRACTION * self.first_rollout_step()
        return self.settings.crps.trajectory_latent_weight * min(1.0, (step + 1) / (warm_up + 1))

    def encode(self, states: Tensor, condition: Tensor, step: int) -> tuple[Tensor, Tensor]:
        """ζ [B, Z] of training trajectories, and the mean of its KL divergence.

        Args:
            states: [B, T+1, D].
            condition: [B, T, C].
            step: optimiser steps already taken.
        """
        if self.encoder is None:
            return states[:, 0, :0], states.new_zeros(())
        changes = states.diff(dim=1) / self.delta_std
        latent, divergence = self.encoder(states[:, :-1], changes, condition)
        self.encoder.update_prior(latent, step)
        return latent, divergence.mean()

    def select(self, baselines: Tensor, actions: Tensor, member: Tensor) -> tuple[Tensor, Tensor]:
        """See `BaselineModel.select`; the condition includes Σ_{τ<t} a_τ [S·K, T, A]."""
        baseline, condition = super().select(baselines, actions, member)
        if not self.settings.crps.action_sum:
            return baseline, condition
        past = ACTION_SUM_SCALE * (actions.cumsum(1) - actions)
        return baseline, torch.cat([condition, repeat_samples(past, member.shape[1])], -1)

    def rollout_losses(
        self, states: Tensor, actions: Tensor, baselines: Tensor
    ) -> dict[str, Tensor]:
        """The scores of m autoregressive rollouts of each trajectory, each from a sampled member.

            E_d log E CRPS_d + weight · log E ES,   states of the ES in units of each E CRPS_d

        The gradient of a logarithm is relative. So the weight of a dimension does not depend on the
        size of its uncertainty.

        Args:
            states, actions, baselines: see `transition_losses`.
        """
        s0, truth, crps = states[:, 0], states[:, 1:], self.settings.crps
        shape = (len(s0), crps.samples)
        # m ~ U{0 … M−1} of each forecast
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
        """Forecasts [S, K, T, D] that add to the baselines.

        Args:
            s0, actions, noise, member: see `Model.sample`.
            baselines: of all members [S, M, T+1, D].
        """
        samples, latent_size = member.shape[1], self.settings.crps.trajectory_latent_size
        baseline, condition = self.select(baselines, actions, member)
        of_trajectory, normal = noise.flatten(0, 1).tensor_split([latent_size], dim=-1)
        latent = of_trajectory[:, 0]
        if self.encoder is not None:
            latent = self.encoder.prior(latent)
        start = repeat_samples(s0, samples)
        constant = torch.cat([latent, start[:, : self.start_size]], -1)[:, None].expand(
            -1, condition.shape[1], -1
        )
        inputs = torch.cat([condition, constant], -1)
        rows = (start, inputs, baseline.diff(dim=1), normal)
        forecasts = self.decoder.generate(*(values[None] for values in rows))[0]
        return forecasts.unflatten(0, (-1, samples))


def two_cycles(step: int, steps: int, one_step_steps: int) -> float:
    """The learning rate as a fraction of its peak: two cycles of a short rise and a cosine decay.

    Args:
        step: the optimiser step, from 0.
        steps: number of all steps.
        one_step_steps: steps of the first cycle, which trains on single transitions.
    """
    if step < one_step_steps:
        peak, part = 1.0, (step + 1) / (one_step_steps + 1)
    else:
        peak, part = ROLLOUT_RATE, (step - one_step_steps + 1) / (steps - one_step_steps + 1)
    return peak * min(1.0, part / 0.05) * max(0.5 * (1 + math.cos(math.pi * part)), 0.003)
