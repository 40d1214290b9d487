"""Dynamics with normal noise, whose standard deviation depends on the past."""

import torch
from torch import Tensor, nn

from study.data.normalization import Normalization
from study.models.networks.architecture import Architecture
from study.models.networks.dynamics import DynamicsNetwork
from study.models.networks.likelihood import heteroscedastic_nll
from study.models.networks.linear import StackedLinear
from study.models.unroll.unroll import bounded

VARIANCE_RATE = 0.05
"""Weight of the last batch in the running mean σ²."""


class GaussianDynamics(DynamicsNetwork):
    """p_θ(s_{t+1} | s_{0:t}; i_{0:t}) = N(ŝ_{t+1}, σ² exp(2 w_{t+1})).

        w_{t+1} = B tanh((y_t W + v) / B)

    ŝ and y are those of `DynamicsNetwork`. σ² has one value for each dimension: the mean of the
    squared errors of training, each divided by exp(2 w). w makes the variance heteroscedastic:
    larger for a flight in wind than for a ball at rest, for example. w is bounded, so that noise
    that is fed back cannot grow without limit.

    Args:
        normalization, architecture: see `DynamicsNetwork`.
        homoscedastic: whether w is always 0.
    """

    variance: Tensor
    """σ² [D], a running mean over batches: see `nll`."""

    def __init__(
        self, normalization: Normalization, architecture: Architecture, homoscedastic: bool = False
    ) -> None:
        super().__init__(normalization, architecture)
        self.register_buffer("variance", torch.ones_like(self.unit))
        self.log_std = StackedLinear(architecture.networks, self.width, self.size)
        nn.init.zeros_(self.log_std.weight)
        self.log_std.requires_grad_(not homoscedastic)

    def predict(
        self, state: Tensor, inputs: Tensor, offset: Tensor, hidden: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        """The means ŝ_{1:T} and w_{1:T} of given states, [M, B, T, D] each.

        The arguments are those of `DynamicsNetwork.mean`.
        """
        mean, top = self.mean(state, inputs, offset, hidden)
        return mean, self.log_std_of(top)

    def predict_rollout(
        self, s0: Tensor, inputs: Tensor, offset: Tensor, hidden: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        """The means ŝ_{1:T} and w_{1:T}, where each mean is fed back, [M, B, T, D] each.

        The arguments are those of `rollout`.
        """
        mean, top = self.rollout(s0, inputs, offset, hidden, return_tops=True)
        return mean, self.log_std_of(top)

    @torch.no_grad()
    def sample_rollout(
        self,
        s0: Tensor,
        inputs: Tensor,
        offset: Tensor,
        normal: Tensor,
        hidden: Tensor | None = None,
        start: Tensor | None = None,
    ) -> Tensor:
        """Sampled states s_{1:T} [M, B, T, D]. Each state is sampled from p_θ and fed back.

        Args:
            s0, inputs, offset, hidden, start: see `rollout`.
            normal: standard normal numbers [M, B, T, D].
        """
        noise = normal * self.variance.sqrt()
        return self.rollout(s0, inputs, offset, hidden, noise=noise, start=start)[0]

    def log_std_of(self, top: Tensor) -> Tensor:
        """w [M, B, T, D] from y [M, B, T, W]."""
        return bounded(self._linear(self.log_std, top).to(self.unit.dtype))

    def nll(self, error: Tensor, log_std: Tensor, step: int, weighted: bool = True) -> Tensor:
        """The negative log-likelihood of a batch, at the optimal σ²; updates the running σ².

        Args:
            error: s − ŝ [..., D].
            log_std: w [..., D].
            step: optimiser steps already taken.
            weighted: the β-NLL, see `heteroscedastic_nll`.

        Returns:
            a scalar: the sum over dimensions, averaged over the rest.
        """
        nll, variance = heteroscedastic_nll(error, log_std, weighted)
        # The loss uses the optimal σ² of each batch. Forecasts need σ² of all data.
        self.variance.lerp_(variance, max(VARIANCE_RATE, 1 / (step + 1)))
        return nll.sum()

    def _log_std_weights(self) -> tuple[Tensor, Tensor]:
        return self.log_std.weight, self.log_std.bias[:, 0]
