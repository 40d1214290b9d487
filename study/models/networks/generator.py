"""Dynamics with functional noise: a generator that is trained by proper scores."""

import torch
from torch import Tensor

from study.data.normalization import Normalization
from study.models.networks.architecture import Architecture
from study.models.networks.dynamics import DynamicsNetwork
from study.models.networks.linear import StackedLinear

GRADIENT_DECAY = 0.8
"""Factor on the gradient of a state, at every step back. Every contact multiplies the gradient, so
the few forecasts with many contacts would dominate the full gradient."""


class GeneratorDynamics(DynamicsNetwork):
    """s_{t+1} = ŝ_{t+1} + u · (z_t R + (y_t · z_t P) Q), with standard normal z_t.

    ŝ and y are those of `DynamicsNetwork` without memory. The noise z_t multiplies hidden units. So
    one step is normal, with a covariance that depends on the state.

    The last inputs, of the size `initially_unused`, have no effect on the stem before training.

    Args:
        normalization: see `DynamicsNetwork`.
        architecture: see `DynamicsNetwork`; without memory.
        noise_size: the size of z_t.
        initially_unused: number of the last inputs that the stem ignores at first.
    """

    gradient_decay = GRADIENT_DECAY

    def __init__(
        self,
        normalization: Normalization,
        architecture: Architecture,
        noise_size: int,
        initially_unused: int = 0,
    ) -> None:
        super().__init__(normalization, architecture)
        count = architecture.networks
        self.noise_gain = StackedLinear(count, noise_size, self.width, bias=False)  # P
        self.noise_shift = StackedLinear(count, noise_size, self.size, bias=False)  # R
        self.noise_output = StackedLinear(count, self.width, self.size, bias=False)  # Q
        with torch.no_grad():
            self.stem.weight[:, self.stem.weight.shape[1] - initially_unused :] = 0
            for layer in (self.output, self.noise_output, self.noise_shift):
                layer.weight.mul_(0.3)

    def transition(self, state: Tensor, inputs: Tensor, change: Tensor) -> tuple[Tensor, Tensor]:
        """The normal distribution of a change of the state, in the canonical frame.

        Args:
            state: s_t [M, B, D].
            inputs: i_t [M, B, I].
            change: (s_{t+1} − k s_t − offset_t) / u [M, B, D], as it was observed.

        Returns:
            the error of the mean, observed minus mean [M, B, D], and a factor G [M, B, Z, D] of the
            covariance Gᵀ G.
        """
        mean, top = self.step(state, inputs)
        error = self.to_canonical(change, state) - mean
        # (y · P_z) Q for all components of z at once.
        gains = self.noise_gain.weight[..., None] * self.noise_output.weight[:, None]
        factor = (top @ gains.movedim(1, 2).flatten(2)).to(self.unit.dtype)
        return error, factor.unflatten(-1, (-1, self.size)) + self.noise_shift.weight[:, None]

    def generate(self, s0: Tensor, inputs: Tensor, offset: Tensor, noise: Tensor) -> Tensor:
        """s_{1:T} [M, B, T, D].

        Args:
            s0: [M, B, D].
            inputs: i_{0:T-1} [M, B, T, I].
            offset: [M, B, T, D].
            noise: z_{0:T-1} [M, B, T, Z].
        """
        shift = self.unit * self._linear(self.noise_shift, noise)
        gain = self._linear(self.noise_gain, noise)
        return self.rollout(s0, inputs, offset + shift, gain=gain)[0]

    def _noise_output(self) -> Tensor:
        return self.noise_output.weight * self.unit
