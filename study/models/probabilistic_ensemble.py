"""An ensemble of probabilistic MLPs, the state of the art of model-based reinforcement learning.

Chua et al., "Deep reinforcement learning in a handful of trials using probabilistic dynamics
models", NeurIPS 2018 (PETS): each member is s_{t+1} ~ N(s_t + μ_m(s_t, a_t), σ_m²(s_t, a_t)), with
log σ² bounded softly, and forecasts are propagated by trajectory sampling:

    TS∞   m ~ U{0 … M−1} once, for the whole trajectory
    TS1   m_t ~ U{0 … M−1} anew at every step
"""

from typing import Any

import torch
from torch import Tensor

from study.data.normalization import Normalization
from study.models.base import each_sample, models
from study.models.model_ensemble import EnsembleOf
from study.models.probabilistic_mlp import ProbabilisticMlp


@models.register("probabilistic_ensemble")
class ProbabilisticEnsemble(EnsembleOf):
    """M probabilistic MLPs; TS∞ or TS1 by the setting `propagation`.

    Only TS∞ tells aleatoric from epistemic: with TS1 no sample is of one member, so it counts as
    a single one.

    Args:
        normalization, settings: see `EnsembleOf`; the section `probabilistic_ensemble` as well.
    """

    member_class = ProbabilisticMlp
    version = ProbabilisticMlp.version
    sections = ("model_ensemble", "probabilistic_ensemble", *ProbabilisticMlp.sections)

    def __init__(self, normalization: Normalization, settings: dict[str, Any]) -> None:
        super().__init__(normalization, settings)
        self.every_step = settings["probabilistic_ensemble"]["propagation"] == "step"
        if self.every_step:
            self.noise_size += 1  # the member of each step is drawn from it

    def members_count(self) -> int:
        """M with TS∞, 1 with TS1."""
        return 1 if self.every_step else super().members_count()

    def sample(self, s0: Tensor, actions: Tensor, noise: Tensor, member: Tensor) -> Tensor:
        """See `Model.sample`."""
        if not self.every_step:
            return super().sample(s0, actions, noise, member)
        samples, (*draws, chance) = member.shape[1], noise.unbind(-1)
        chosen, normal = self.drawn(chance), torch.stack(draws, dim=-1)
        state, states = each_sample(s0, samples), []
        controls = each_sample(actions, samples)
        for t, action in enumerate(controls.unbind(1)):
            own, draw = chosen[:, :, t].flatten(), normal[:, :, t].flatten(0, 1)
            following = torch.empty_like(state)
            for index, network in enumerate(self.each()):
                rows = torch.nonzero(own == index)[:, 0]
                following[rows] = network.step(state[rows], action[rows], draw[rows])
            state = following
            states.append(state)
        return torch.stack(states, dim=1).unflatten(0, (-1, samples))

    def drawn(self, chance: Tensor) -> Tensor:
        """m ~ U{0 … M−1} [...] from standard normal numbers [...]: ⌊M Φ(x)⌋."""
        count = len(self.members)
        share = torch.special.ndtr(chance.double())
        return (count * share).long().clamp(max=count - 1)
