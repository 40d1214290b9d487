"""Generators trained by a proper score of their own forecasts, without an encoder and without β.

A strictly proper score is least, on average, for the true distribution. So it can be minimised
directly: draw m forecasts of each training trajectory, freely, and score them against what happened
(Gneiting and Raftery, JASA 102, 2007, section 5; Pacchiardi et al., JMLR 25, 2024). With F forecast
and y observed,

    CRPS(F, y) = E|x − y| − ½ E|x − x'|            of each number
    ES(F, y)   = E‖x − y‖ − ½ E‖x − x'‖            of vectors: the joint state

estimated without bias for any m ≥ 2 (the fair form: pairs of one and the same forecast left out).
"""

from typing import Any

import torch
from torch import Tensor

from study.data.scaling import Scaling
from study.models.baseline import OnBaseline
from study.models.decoder import RecurrentDecoder
from study.models.forecaster import each_sample

# Steps between two states whose difference is scored as an increment.
LAG = 5
_LEAST = 1e-6


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
    """A recurrent decoder on a baseline, driven by noise; a subclass says which baseline.

    The first components of the noise stay for the whole trajectory, for what is hidden and lasts
    (a payload); the others are drawn at every step.

    Args:
        scaling: standard units.
        settings: the sections `crps` and `train` of the configuration.
        output: what the decoder gives, the target (`direct`) or its change (`increment`).
        extra_conditions: size of what the decoder sees beside the actions.
    """

    sections = ("crps", "train")

    def __init__(
        self, scaling: Scaling, settings: dict[str, Any], output: str, extra_conditions: int = 0
    ) -> None:
        super().__init__(scaling, settings)
        crps = settings["crps"]
        self.noise_size, self.lasting = int(crps["noise_size"]), int(crps["lasting"])
        increments = output == "increment"
        self.decode = RecurrentDecoder(
            self.change_scale if increments else torch.ones_like(self.change_scale),
            self.action_size + extra_conditions,
            crps["hidden_size"],
            crps["noise_size"],
            increments=increments,
        )

    def losses(self, batch: dict[str, Tensor], step: int) -> dict[str, Tensor]:
        """m free forecasts of each trajectory, each from a member of its own, and their score."""
        states, actions, crps = batch["states"], batch["actions"], self.settings["crps"]
        s0, truth, samples = states[:, 0], states[:, 1:], crps["samples"]
        members = self.members_count()
        member = torch.randint(members, (len(s0), samples), device=s0.device)
        noise = torch.randn(*member.shape, truth.shape[1], self.noise_size, device=s0.device)
        forecasts = self._generate(s0, actions, noise, member, batch.get("members"))
        forecasts = forecasts.movedim(1, 2)  # [B, T, m, D]
        each = fair_score(forecasts.movedim(-1, -2)[..., None], truth[..., None]).mean((0, 1))
        # Of a logarithm the derivative is relative: a number counts by its own uncertainty.
        loss = each.clamp(min=_LEAST).log().mean()
        unit = each.detach().clamp(min=_LEAST)
        forecasts, truth = forecasts / unit, truth / unit
        joint = fair_score(forecasts, truth).mean()
        loss = loss + crps["energy"] * joint.clamp(min=_LEAST).log()
        if crps["increments"]:
            change, true_change = (x[:, LAG:] - x[:, :-LAG] for x in (forecasts, truth))
            moved = fair_score(change, true_change).mean()
            loss = loss + crps["increments"] * moved.clamp(min=_LEAST).log()
        return {"loss": loss, "loss/crps": each.mean(), "loss/energy_score": joint}

    def sample(self, s0: Tensor, actions: Tensor, noise: Tensor, member: Tensor) -> Tensor:
        """See `Model.sample`."""
        return self._generate(s0, actions, noise, member, None)

    def _generate(
        self, s0: Tensor, actions: Tensor, noise: Tensor, member: Tensor, members: Tensor | None
    ) -> Tensor:
        """Forecasts [S, K, T, D]; noise [S, K, T, `noise_size`]."""
        samples = member.shape[1]
        baseline, condition = self.conditions(s0, actions, member, members)
        lasting = noise[:, :, :1, : self.lasting].expand(-1, -1, noise.shape[2], -1)
        latent = torch.cat([lasting, noise[..., self.lasting :]], dim=-1).flatten(0, 1)
        forecasts = self.decode(each_sample(s0, samples), baseline, condition, latent)
        return forecasts.unflatten(0, (-1, samples))
