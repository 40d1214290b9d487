"""An ensemble of probabilistic MLPs with trajectory sampling (PETS).

Chua et al., "Deep reinforcement learning in a handful of trials using probabilistic dynamics
models", NeurIPS 2018: each member is a `ProbabilisticMlp`. Forecasts are propagated by trajectory
sampling:

    TS∞   m ~ U{0 … M−1} once for the whole trajectory
    TS1   m_t ~ U{0 … M−1} at every step
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from study.config.model_sections import ProbabilisticEnsemble
from study.data.normalization import Normalization
from study.models.base import models
from study.models.model_ensemble import EnsembleOfModels, EnsembleOfModelsSettings
from study.models.probabilistic_mlp import MlpSettings, ProbabilisticMlp
from study.models.sampling import repeat_samples


@dataclass(frozen=True)
class MlpEnsembleSettings(MlpSettings, EnsembleOfModelsSettings):
    """Settings of an ensemble of probabilistic MLPs."""

    probabilistic_ensemble: ProbabilisticEnsemble


@models.register("probabilistic_ensemble")
class ProbabilisticMlpEnsemble(EnsembleOfModels[MlpEnsembleSettings, ProbabilisticMlp]):
    """M probabilistic MLPs; TS∞ or TS1 by the setting `propagation`.

    Only TS∞ separates aleatoric from epistemic uncertainty. With TS1 no sample belongs to one
    member, so `members_count` is 1.
    """

    settings_class = MlpEnsembleSettings
    member_class = ProbabilisticMlp

    def __init__(self, normalization: Normalization, settings: MlpEnsembleSettings) -> None:
        count = settings.model_ensemble.members
        members = [ProbabilisticMlp(normalization, settings) for _ in range(count)]
        super().__init__(normalization, settings, members)
        self.samples_every_step = settings.probabilistic_ensemble.propagation == "step"
        if self.samples_every_step:
            self.noise_size += 1  # the last number chooses the member of the step

    def members_count(self) -> int:
        """M with TS∞, 1 with TS1."""
        return 1 if self.samples_every_step else super().members_count()

    def sample(self, s0: Tensor, actions: Tensor, noise: Tensor, member: Tensor) -> Tensor:
        """See `Model.sample`."""
        if not self.samples_every_step:
            return super().sample(s0, actions, noise, member)
        samples = member.shape[1]
        normal, choice = noise.flatten(0, 1).tensor_split([-1], dim=-1)
        steps = zip(
            repeat_samples(actions, samples).unbind(1),
            normal.unbind(1),
            self.member_of(choice[..., 0]).unbind(1),
            strict=True,
        )
        start, states = repeat_samples(s0, samples), []
        state = start
        for action, normal_t, member_t in steps:
            next_state = torch.empty_like(state)
            for index, model in enumerate(self.member_models()):
                rows = torch.nonzero(member_t == index)[:, 0]
                next_state[rows] = model.step(
                    state[rows], action[rows], normal_t[rows], start[rows]
                )
            state = next_state
            states.append(state)
        return torch.stack(states, dim=1).unflatten(0, (-1, samples))

    def log_density(self, states: Tensor, actions: Tensor) -> Tensor:
        """See `study.models.log_score.HasDensity`: of the mixture of the members.

        With TS∞ a member that made the past steps likely has a larger weight in the next ones.
        """
        members = [model.log_density(states, actions) for model in self.member_models()]
        steps = torch.stack(members)  # [M, S, T]
        count = math.log(len(members))
        if self.samples_every_step:
            return steps.logsumexp(0) - count
        past = steps.cumsum(-1).logsumexp(0) - count
        return past.diff(dim=-1, prepend=torch.zeros_like(past[:, :1]))

    def member_of(self, normal: Tensor) -> Tensor:
        """m ~ U{0 … M−1} [...] from standard normal numbers x [...]: m = ⌊M Φ(x)⌋."""
        count = len(self.members)
        quantile = torch.special.ndtr(normal.double())
        return (count * quantile).long().clamp(max=count - 1)
