"""Generators trained by a proper score of their own forecasts, without an encoder and without β.

A strictly proper score is least, on average, for the true distribution. So it can be minimised
directly: draw m forecasts of each training trajectory, freely, and score them against what happened
(Gneiting and Raftery, JASA 102, 2007, section 5; Pacchiardi et al., JMLR 25, 2024). With F forecast
and y observed,

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

from study.data.scaling import Scaling
from study.models.baseline import OnBaseline
from study.models.decoder import RecurrentDecoder
from study.models.forecaster import each_sample
from study.models.transition import TransitionDecoder

# Steps between two states whose difference is scored as an increment.
LAG = 5
_LEAST = 1e-6

# Until which share of the training how many steps are forecast freely; then the whole horizon.
PIECES = ((0.6, 1), (0.64, 8), (0.68, 32))
# So many pieces of a batch at most serve for one step of the optimiser: of single transitions
# there are more than it needs.
PIECES_AT_ONCE = 1024
# The learning rate's peak for more than single transitions, as a share of the first.
FREE_RATE = 0.2
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

    Training begins with single transitions, from which a contact of a few hundredths of a second
    can be learned, and goes on to ever longer pieces of trajectories that are forecast freely
    (`PIECES`). Each generator has a budget of its own in the section `crps`, since it has no β to
    search for.

    Args:
        scaling: standard units.
        settings: the sections `crps` and `train` of the configuration.
        output: what a recurrent decoder gives, the target (`direct`) or its change (`increment`).
        extra_conditions: size of what the decoder sees beside the actions.
    """

    sections = ("crps", "train")

    def __init__(
        self, scaling: Scaling, settings: dict[str, Any], output: str, extra_conditions: int = 0
    ) -> None:
        super().__init__(scaling, settings)
        crps = settings["crps"]
        self.noise_size, self.lasting = int(crps["noise_size"]), int(crps["lasting"])
        sizes = (self.action_size + extra_conditions, crps["hidden_size"], crps["noise_size"])
        self.decode: RecurrentDecoder | TransitionDecoder
        if crps["decoder"] == "transition":
            self.decode = TransitionDecoder(self.change_scale, *sizes, self.lasting)
        else:
            increments = output == "increment"
            unit = self.change_scale if increments else torch.ones_like(self.change_scale)
            self.decode = RecurrentDecoder(unit, *sizes, increments=increments)

    @classmethod
    def budget(cls, settings: dict[str, Any]) -> dict[str, Any]:
        """See `Model.budget`: that of the section `crps`. It is looked at ten times, to its end.

        Early looks say little: a network that knows single transitions forecasts badly.
        """
        own = {name: settings["crps"][name] for name in ("steps", "batch_size", "learning_rate")}
        looks = {"validate_every": max(1, own["steps"] // LOOKS), "patience": own["steps"]}
        return settings["train"] | own | looks

    def see(self, states: Tensor) -> None:
        """See `Model.see`: forecasts keep to their range."""
        if isinstance(self.decode, TransitionDecoder):
            self.decode.bound(states)

    def schedule(self, optimizer: Optimizer, learning_rate: float, steps: int) -> LRScheduler:
        """One cycle for single transitions, and a lower one for longer pieces.

        Free forecasts answer to a change of the weights far more than single transitions do.
        """
        if isinstance(self.decode, RecurrentDecoder):
            return super().schedule(optimizer, learning_rate, steps)
        return LambdaLR(optimizer, partial(two_cycles, steps=steps))

    def piece(self, step: int, horizon: int) -> int:
        """Steps that are forecast freely at this step of training.

        A recurrent decoder is trained on whole trajectories: in pieces it would learn to know no
        more of the past than their first state.
        """
        share = step / self.settings["train"]["steps"]
        if isinstance(self.decode, RecurrentDecoder):
            return horizon
        return next((min(length, horizon) for until, length in PIECES if share < until), horizon)

    def losses(self, batch: dict[str, Tensor], step: int) -> dict[str, Tensor]:
        """m free forecasts of each piece, each from a member of its own, and their score."""
        states, actions, crps = batch["states"], batch["actions"], self.settings["crps"]
        baselines = self.baselines(states[:, 0], actions, batch.get("members"))
        length = self.piece(step, actions.shape[1])
        states, actions, baselines = cut(states, actions, baselines, length)
        if len(states) > PIECES_AT_ONCE:
            chosen = torch.randperm(len(states), device=states.device)[:PIECES_AT_ONCE]
            states, actions, baselines = states[chosen], actions[chosen], baselines[chosen]
        s0, truth, samples = states[:, 0], states[:, 1:], crps["samples"]
        member = torch.randint(self.members_count(), (len(s0), samples), device=s0.device)
        noise = torch.randn(*member.shape, length, self.noise_size, device=s0.device)
        if length == 1:
            # In a single step all noise is alike. Taught there, the lasting noise would push the
            # same way in every step of a forecast.
            noise[..., : self.lasting] = 0
        forecasts = self._generate(s0, actions, noise, member, baselines)
        forecasts = forecasts.movedim(1, 2)  # [B, T, m, D]
        each = fair_score(forecasts.movedim(-1, -2)[..., None], truth[..., None]).mean((0, 1))
        # Of a logarithm the derivative is relative: a number counts by its own uncertainty.
        loss = each.clamp(min=_LEAST).log().mean()
        unit = each.detach().clamp(min=_LEAST)
        if length == 1:
            loss = loss + mean_error(forecasts, truth)
        forecasts, truth = forecasts / unit, truth / unit
        joint = fair_score(forecasts, truth).mean()
        loss = loss + crps["energy"] * joint.clamp(min=_LEAST).log()
        if crps["increments"] and length > LAG:
            change, true_change = (x[:, LAG:] - x[:, :-LAG] for x in (forecasts, truth))
            moved = fair_score(change, true_change).mean()
            loss = loss + crps["increments"] * moved.clamp(min=_LEAST).log()
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


def cut(
    states: Tensor, actions: Tensor, baselines: Tensor, length: int
) -> tuple[Tensor, Tensor, Tensor]:
    """Trajectories cut into P pieces of `length` steps; what is left over falls to both ends.

    Args:
        states: [B, T+1, D].
        actions: [B, T, A].
        baselines: [B, M, T+1, D].
        length: h, at most T.

    Returns:
        [B·P, h+1, D], [B·P, h, A] and [B·P, M, h+1, D].
    """
    rest = actions.shape[1] % length
    first = int(torch.randint(rest + 1, ()))
    last = actions.shape[1] - rest + first
    pieces = states[:, first : last + 1].unfold(1, length + 1, length)
    moves = actions[:, first:last].unfold(1, length, length)
    under = baselines[:, :, first : last + 1].unfold(2, length + 1, length).movedim(2, 1)
    cuts = (each.flatten(0, 1).movedim(-1, -2) for each in (pieces, moves, under))
    states, actions, baselines = cuts
    return states, actions, baselines


def mean_error(forecasts: Tensor, observed: Tensor) -> Tensor:
    """Squared error of the forecast's mean, in units of that of a single forecast.

        E (E x − y)² / E (x − y)²,   (E x − y)² by (x_1 − y)(x_2 − y), without bias

    averaged over the dimensions. The denominator counts as a constant, without derivative. The
    numerator is least when the mean is right, whatever the spread, so beside a proper score the
    derivative still vanishes at the true distribution.

    Why it is needed: a score of absolute distances sees no point in an event that comes seldom, of
    which it cannot yet say when; "never" is a fair median. The mean does, and so leads to where the
    event can be told.

    Args:
        forecasts: x [B, T, m, D]; the first two of m count.
        observed: y [B, T, D].
    """
    first, second = (forecasts[:, :, k] - observed for k in (0, 1))
    squared = 0.5 * (first.square() + second.square()).mean((0, 1)).detach()
    return ((first * second).mean((0, 1)) / squared.clamp(min=_LEAST**2)).mean()


def two_cycles(step: int, steps: int) -> float:
    """The learning rate as a share of its peak: twice it rises briefly and falls by a cosine."""
    single, share = PIECES[0][0], (step + 1) / (steps + 1)
    if share < single:
        peak, share = 1.0, share / single
    else:
        peak, share = FREE_RATE, (share - single) / (1 - single)
    return peak * min(1.0, share / 0.05) * max(0.5 * (1 + math.cos(math.pi * share)), 0.003)
