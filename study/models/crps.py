"""Generators trained by proper scores of their own forecasts, without an encoder and without β.

A strictly proper score is least, on average, for the true distribution. So it can be minimised
directly (Gneiting and Raftery, JASA 102, 2007, section 5; Pacchiardi et al., JMLR 25, 2024). Two
are used here. Of a single step the distribution F of each number is known, and has the logarithmic
score

    LS(F, y) = −log p_F(y)

From the distribution of whole trajectories one can only draw. m forecasts of each, freely, are
scored against what happened, which is also where it is learned how numbers go together: with x
forecast and y observed,

    CRPS(F, y) = E|x − y| − ½ E|x − x'|            of each number
    ES(F, y)   = E‖x − y‖ − ½ E‖x − x'‖            of vectors: the joint state

estimated without bias for any m ≥ 2 (the fair form: pairs of one and the same forecast left out).
"""

import math
from functools import partial
from typing import Any

import torch
from torch import Tensor
from torch.optim import Optimizer
from torch.optim.lr_scheduler import LambdaLR, LRScheduler

from study.data.normalization import Normalization
from study.models.base import each_sample
from study.models.baseline import OnBaseline
from study.models.networks.likelihood import logarithmic_score
from study.models.networks.transition import TransitionDecoder

_LEAST = 1e-6

# How many transitions, and how many trajectories, serve for one step of the optimiser.
TRANSITIONS = 512
TRAJECTORIES = 12
# The learning rate's peak for whole trajectories, as a share of that for single transitions.
FREE_RATE = 0.1
# Times that the validation data are looked at in a fit.
LOOKS = 10


def fair_score(forecasts: Tensor, observed: Tensor) -> Tensor:
    """Fair energy score [...] of vectors; of vectors of one number it is the fair CRPS.

        1/m Σ_i ‖x_i − y‖ − 1/(2m(m − 1)) Σ_{i≠j} ‖x_i − x_j‖

    Args:
        forecasts: x [..., m, D], m ≥ 2.
        observed: y [..., D].
    """
    samples = forecasts.shape[-2]
    far = _norm(forecasts - observed[..., None, :]).mean(-1)
    first, second = torch.triu_indices(samples, samples, 1, device=forecasts.device)
    apart = _norm(forecasts[..., first, :] - forecasts[..., second, :]).mean(-1)
    return far - 0.5 * apart


def _norm(vectors: Tensor) -> Tensor:
    """Euclidean norm over the last axis, with a derivative where it is zero."""
    if vectors.shape[-1] == 1:
        return vectors[..., 0].abs()
    return (vectors.square().sum(-1) + 1e-12).sqrt()


class CrpsGenerator(OnBaseline):
    """A decoder on a baseline, driven by noise; a subclass says which baseline.

    The first components of the noise stay for the whole trajectory, for what is hidden and lasts
    (a payload); the others are drawn at every step.

    It learns single transitions first, from which a contact of a few hundredths of a second can be
    learned, and whole trajectories after that: what lasts, and how errors add up. It has a budget
    of its own in the section `crps`, since it has no β to search for.

    Args:
        normalization: standard units.
        settings: the sections `crps` and `train` of the configuration.
        extra_conditions: size of what the decoder sees beside the actions.
    """

    sections = ("crps", "train")

    def __init__(
        self, normalization: Normalization, settings: dict[str, Any], extra_conditions: int = 0
    ) -> None:
        super().__init__(normalization, settings)
        crps = settings["crps"]
        self.noise_size, self.lasting = int(crps["noise_size"]), int(crps["persistent_noise_size"])
        sizes = (self.action_size + extra_conditions, crps["hidden_size"], self.noise_size)
        self.decode = TransitionDecoder(normalization, *sizes, self.lasting)

    @classmethod
    def budget(cls, settings: dict[str, Any]) -> dict[str, Any]:
        """See `Model.budget`: that of the section `crps`. A tenth of it lies between two looks.

        It goes to its end, since early looks say little: a network that knows single transitions
        may forecast badly.
        """
        own = {name: settings["crps"][name] for name in ("steps", "batch_size", "learning_rate")}
        looks = {"validate_every": max(1, own["steps"] // LOOKS), "patience": own["steps"]}
        return settings["train"] | own | looks

    def see(self, states: Tensor) -> None:
        """See `Model.see`: forecasts keep to their range."""
        self.decode.bound(states)

    def first_free(self) -> int:
        """The first step of the optimiser that serves whole trajectories."""
        return round(self.settings["crps"]["one_step_fraction"] * self.settings["train"]["steps"])

    def forgets(self, step: int) -> bool:
        """See `Model.forgets`: the gradient of trajectories is of another size."""
        return step == self.first_free()

    def schedule(self, optimizer: Optimizer, learning_rate: float, steps: int) -> LRScheduler:
        """One cycle for single transitions, and a lower one for trajectories.

        Free forecasts answer to a change of the weights far more than single transitions do.
        """
        cycles = partial(two_cycles, steps=steps, single=self.first_free())
        return LambdaLR(optimizer, cycles)

    def losses(self, batch: dict[str, Tensor], step: int) -> dict[str, Tensor]:
        """See `Model.losses`."""
        free = step >= self.first_free()
        if free:
            batch = {name: values[:TRAJECTORIES] for name, values in batch.items()}
        states, actions = batch["states"], batch["actions"]
        baselines = self.baselines(states[:, 0], actions, batch.get("members"))
        losses = self.trajectory_losses if free else self.transition_losses
        return losses(states, actions, baselines)

    def transition_losses(
        self, states: Tensor, actions: Tensor, baselines: Tensor
    ) -> dict[str, Tensor]:
        """The logarithmic score of single transitions, and the error of their mean.

        Steps of the horizon at which states change much, in units of how the change varies, are
        drawn more often: a start from rest comes once in a trajectory. The lasting noise is left
        out: in a single step all noise is alike.

        Args:
            states: [B, T+1, D].
            actions: [B, T, A].
            baselines: [B, M, T+1, D].
        """
        scale, horizon = self.delta_std, actions.shape[1]
        liveliness = 1 + (states.diff(dim=1) / scale).square().mean((0, 2))
        likely = liveliness.expand(len(states), -1).flatten()
        chosen = torch.multinomial(likely, TRANSITIONS, replacement=True)
        row, at = chosen // horizon, chosen % horizon
        member = torch.randint(self.members_count(), chosen.shape, device=chosen.device)
        baseline = torch.stack([baselines[row, member, at], baselines[row, member, at + 1]], 1)
        condition = self.beside(baseline, actions[row, at][:, None])[:, 0]
        drift = baseline[:, 1] - baseline[:, 0]
        state = states[row, at]
        mean, factor = self.decode.transition(state, drift, condition, states[row, 0])
        error = (states[row, at + 1] - state - drift) / scale - mean
        score = logarithmic_score(error, factor.square().sum(1).clamp(min=_LEAST**2))
        # See `logarithmic_score`: what the score alone takes for noise, this does not.
        of_mean = error.square().mean(0).clamp(min=_LEAST**2).log().mean()
        return {"loss": score + of_mean, "loss/transitions": score, "loss/mean": of_mean}

    def trajectory_losses(
        self, states: Tensor, actions: Tensor, baselines: Tensor
    ) -> dict[str, Tensor]:
        """m free forecasts of each trajectory, each from a member of its own, and their score.

        Args:
            states, actions, baselines: see `transition_losses`.
        """
        s0, truth, crps = states[:, 0], states[:, 1:], self.settings["crps"]
        shape = (len(s0), crps["samples"])
        member = torch.randint(self.members_count(), shape, device=s0.device)
        noise = torch.randn(*shape, truth.shape[1], self.noise_size, device=s0.device)
        forecasts = self._generate(s0, actions, noise, member, baselines)
        forecasts = forecasts.movedim(1, 2)  # [B, T, m, D]
        each = fair_score(forecasts.movedim(-1, -2)[..., None], truth[..., None]).mean((0, 1))
        # Of a logarithm the derivative is relative: a number counts by its own uncertainty.
        loss = each.clamp(min=_LEAST).log().mean()
        unit = each.detach().clamp(min=_LEAST)
        forecasts, truth = forecasts / unit, truth / unit
        joint = fair_score(forecasts, truth).mean()
        loss = loss + crps["energy_weight"] * joint.clamp(min=_LEAST).log()
        return {"loss": loss, "loss/crps": each.mean(), "loss/energy_score": joint}

    def sample(self, s0: Tensor, actions: Tensor, noise: Tensor, member: Tensor) -> Tensor:
        """See `Model.sample`."""
        return self._generate(s0, actions, noise, member, self.baselines(s0, actions, None))

    def _generate(
        self, s0: Tensor, actions: Tensor, noise: Tensor, member: Tensor, baselines: Tensor
    ) -> Tensor:
        """Forecasts [S, K, T, D]; noise [S, K, T, `noise_size`], baselines [S, M, T+1, D]."""
        samples = member.shape[1]
        baseline, condition = self.drawn(baselines, actions, member)
        lasting = noise[:, :, :1, : self.lasting].expand(-1, -1, noise.shape[2], -1)
        latent = torch.cat([lasting, noise[..., self.lasting :]], dim=-1).flatten(0, 1)
        forecasts = self.decode(each_sample(s0, samples), baseline, condition, latent)
        return forecasts.unflatten(0, (-1, samples))


def two_cycles(step: int, steps: int, single: int) -> float:
    """The learning rate as a share of its peak: twice it rises briefly and falls by a cosine.

    Args:
        step: of the optimiser, from 0.
        steps: of all training.
        single: so many of them are for single transitions.
    """
    if step < single:
        peak, share = 1.0, (step + 1) / (single + 1)
    else:
        peak, share = FREE_RATE, (step - single + 1) / (steps - single + 1)
    return peak * min(1.0, share / 0.05) * max(0.5 * (1 + math.cos(math.pi * share)), 0.003)
