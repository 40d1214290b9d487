"""The models as one would write them with `torch.nn`, to compare with.

Equations, weights and loss are the same; only the networks differ. There is a loop over the steps
with `Linear` and `GRUCell`, one network after the other. The encoder feeds nothing back, and is a
`GRU`, which is faster. Loops split sequences once (`unbind`): an index at each step would cost the
derivative a copy of the whole sequence.

With `network.features` at ``none`` the recurrent networks are a plain `GRUCell` with a linear
output, and the others an MLP.
"""

from copy import deepcopy
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn.functional import silu

from study.models import Model
from study.models.crps import CrpsModel
from study.models.networks.cvae import RecurrentCvae
from study.models.networks.dynamics import DynamicsNetwork
from study.models.networks.gaussian import GaussianDynamics
from study.models.networks.linear import StackedLinear
from study.models.probabilistic_mlp import ProbabilisticMlp
from study.models.residual_vae import ResidualVae
from study.models.rnn_ensemble import RnnEnsemble
from study.models.unroll.unroll import LOG_STD_BOUND
from study.models.vae import VaeModel

LINEAR = ("skip", "start_skip", "stem", "mix", "output", "initial_hidden", "log_std")
"""Layers of a `DynamicsNetwork`, which need not have all of them."""
GENERATOR = ("noise_gain", "noise_shift", "noise_output")
"""Layers of a `GeneratorDynamics`."""
BUFFERS = ("unit", "lowest", "highest", "angles", "angle_mean", "angle_scale")


def plain(model: Model) -> Model:
    """A copy whose networks are written with `torch.nn`."""
    copy = deepcopy(model)
    if isinstance(copy, RnnEnsemble):
        copy.members = PlainDynamics(copy.members)  # type: ignore[assignment]
    if isinstance(copy, VaeModel):
        copy.cvae = PlainCvae(copy.cvae)
    if isinstance(copy, ProbabilisticMlp):
        copy.network = PlainDynamics(copy.network)  # type: ignore[assignment]
    if isinstance(copy, CrpsModel):
        copy.decoder = PlainDynamics(copy.decoder)  # type: ignore[assignment]
    if isinstance(copy, ResidualVae):
        assert copy.ensemble is not None
        copy.ensemble.members = PlainDynamics(copy.ensemble.members)  # type: ignore[assignment]
        copy.ensemble.requires_grad_(False)
    return copy


class PlainNetwork(nn.Module):
    """One of the M networks of a `DynamicsNetwork`, with its weights."""

    unit: Tensor
    lowest: Tensor
    highest: Tensor
    angles: Tensor
    angle_mean: Tensor
    angle_scale: Tensor

    def __init__(self, dynamics: DynamicsNetwork, index: int) -> None:
        super().__init__()
        self.shape, self.decay = dynamics.architecture, dynamics.gradient_decay
        for name in BUFFERS:
            self.register_buffer(name, getattr(dynamics, name))
        named = {name: getattr(dynamics, name, None) for name in LINEAR + GENERATOR}
        self.linear = nn.ModuleDict(
            {name: _linear(layer, index) for name, layer in named.items() if layer is not None}
        )
        layers = (layer for layer in dynamics.layers if isinstance(layer, StackedLinear))
        self.layers = nn.ModuleList(_linear(layer, index) for layer in layers)
        self.generates = "noise_gain" in self.linear
        if self.shape.memory:
            self.cell = _cell(
                dynamics.gates.weight[index].T,
                dynamics.gates.bias[index, 0],
                dynamics.gates_of_hidden.weight[index].T,
                dynamics.hidden_bias[index, 0],
            )

    def forward(
        self,
        s0: Tensor,
        inputs: Tensor,
        offset: Tensor,
        hidden: Tensor | None = None,
        noise: Tensor | None = None,
        truth: Tensor | None = None,
    ) -> tuple[Tensor, Tensor]:
        """States s_{1:T} and log standard deviations w_{1:T} [B, T, D]; w = 0 without noise.

        Args:
            s0, inputs, offset, hidden: see `DynamicsNetwork.rollout`, without the axis M.
            noise: [B, T, D], which exp(w) multiplies; of a generator z [B, T, Z].
            truth: s_{0:T-1} [B, T, D] for teacher forcing.
        """
        state, states, log_stds, steps = s0, [], [], inputs.shape[1]
        of_start = self.linear["start_skip"](s0) if "start_skip" in self.linear else 0.0
        noises = [None] * steps if noise is None else noise.unbind(1)
        truths = [None] * steps if truth is None else truth.unbind(1)
        sequences = (inputs.unbind(1), offset.unbind(1), noises, truths)
        for inputs_t, offset_t, noise_t, truth_t in zip(*sequences, strict=True):
            previous = state.clone() if truth_t is None else truth_t
            if self.decay != 1 and previous.requires_grad:
                previous.register_hook(lambda gradient: self.decay * gradient)
            output, top, hidden = self.step(previous, inputs_t, hidden)
            log_std = torch.zeros_like(output)
            if "log_std" in self.linear:
                log_std = LOG_STD_BOUND * torch.tanh(self.linear["log_std"](top) / LOG_STD_BOUND)
            if self.generates and noise_t is not None:
                gain = self.linear["noise_gain"](noise_t)
                output = output + self.linear["noise_output"](top * gain)
                output = output + self.linear["noise_shift"](noise_t)
            state = offset_t + self.unit * (output + of_start)
            if self.shape.delta:
                state = previous + state
            if not self.generates and noise_t is not None:
                state = state + torch.exp(log_std) * noise_t
            if truth is None:
                state = torch.clamp(state, self.lowest, self.highest)
            states.append(state)
            log_stds.append(log_std)
        return torch.stack(states, dim=1), torch.stack(log_stds, dim=1)

    def step(
        self, state: Tensor, inputs: Tensor, hidden: Tensor | None
    ) -> tuple[Tensor, Tensor, Tensor | None]:
        """The output [B, D], y [B, W] and h_{t+1} [B, H]."""
        angle = state[:, self.angles] * self.angle_scale + self.angle_mean
        waves = [angle.sin(), angle.cos(), (2 * angle).sin(), (2 * angle).cos()]
        x = torch.cat([state, *waves, inputs], -1)
        if self.shape.product:
            u, v = self.linear["stem"](x).chunk(2, -1)
            top = u * silu(v)
        elif not self.shape.memory:
            top = silu(self.linear["stem"](x))
        if self.shape.memory and self.shape.product:
            hidden = self.cell(torch.cat([x, top], -1), hidden)
            top = top + self.linear["mix"](torch.cat([hidden, top], -1))
        elif self.shape.memory:
            top = hidden = self.cell(x, hidden)
        for layer in self.layers:
            top = top + silu(layer(top))
        output = self.linear["output"](top)
        if self.shape.product:
            output = output + self.linear["skip"](x)
        return output, top, hidden


class PlainDynamics(nn.Module):
    """A `DynamicsNetwork`, one network after the other, with those methods that models call."""

    variance: Tensor

    def __init__(self, dynamics: DynamicsNetwork) -> None:
        super().__init__()
        self.size, count = dynamics.size, dynamics.architecture.networks
        self.networks = nn.ModuleList(PlainNetwork(dynamics, index) for index in range(count))
        if isinstance(dynamics, GaussianDynamics):
            self.register_buffer("variance", dynamics.variance)

    nll = GaussianDynamics.nll

    def start(self, s0: Tensor, start: Tensor) -> Tensor:
        """See `DynamicsNetwork.start`."""
        networks: list[Any] = list(self.networks)
        rows = zip(networks, torch.cat([s0, start], -1), strict=True)
        return torch.stack([torch.tanh(one.linear["initial_hidden"](x)) for one, x in rows])

    def mean(
        self, state: Tensor, inputs: Tensor, offset: Tensor, hidden: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        """See `DynamicsNetwork.mean`; w instead of y."""
        return self._unroll(state[:, :, 0], inputs, offset, hidden, None, state)

    def rollout(
        self, s0: Tensor, inputs: Tensor, offset: Tensor, hidden: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        """See `DynamicsNetwork.rollout`; w instead of y."""
        return self._unroll(s0, inputs, offset, hidden)

    predict, predict_rollout = mean, rollout

    def sample_rollout(
        self,
        s0: Tensor,
        inputs: Tensor,
        offset: Tensor,
        normal: Tensor,
        hidden: Tensor | None = None,
    ) -> Tensor:
        """See `GaussianDynamics.sample_rollout`."""
        return self._unroll(s0, inputs, offset, hidden, normal * self.variance.sqrt())[0]

    def generate(self, s0: Tensor, inputs: Tensor, offset: Tensor, noise: Tensor) -> Tensor:
        """See `GeneratorDynamics.generate`."""
        return self._unroll(s0, inputs, offset, None, noise)[0]

    def _unroll(self, *arguments: Tensor | None) -> tuple[Tensor, Tensor]:
        """`PlainNetwork.forward` of each network, on arguments with a leading axis M."""
        results = [
            network(*(None if value is None else value[index] for value in arguments))
            for index, network in enumerate(self.networks)
        ]
        states, log_stds = zip(*results, strict=True)
        return torch.stack(states), torch.stack(log_stds)


class PlainCvae(RecurrentCvae):
    """`RecurrentCvae`, with its weights and its methods."""

    def __init__(self, cvae: RecurrentCvae) -> None:
        nn.Module.__init__(self)
        self.uses_target, self.delta = cvae.uses_target, cvae.delta
        gates = cvae.encoder_gates_of_input
        hidden = cvae.encoder_gates_of_hidden.weight
        weights = _in_order_of_torch(gates.weight, gates.bias, hidden, cvae.encoder_bias)
        self.encoder = nn.GRU(gates.in_features, len(cvae.encoder_bias), batch_first=True)
        self.encoder.load_state_dict({f"{name}_l0": value for name, value in weights.items()})
        self.posterior = cvae.posterior
        self.decoder = PlainDynamics(cvae.decoder)  # type: ignore[assignment]

    def encode(self, target: Tensor, states: Tensor, condition: Tensor) -> tuple[Tensor, Tensor]:
        """See `RecurrentCvae.encode`."""
        inputs = [target, states, condition] if self.uses_target else [states, condition]
        hiddens, _ = self.encoder(torch.cat(inputs, -1))
        mean, log_variance = self.posterior(hiddens).chunk(2, dim=-1)
        return mean, log_variance.clamp(-12.0, 6.0)


def _linear(stacked: StackedLinear, index: int) -> nn.Linear:
    weight = stacked.weight[index].T
    linear = nn.Linear(weight.shape[1], weight.shape[0], bias=stacked.has_bias)
    tensors = {"weight": weight}
    if stacked.has_bias:
        tensors["bias"] = stacked.bias[index, 0]
    linear.load_state_dict(tensors)
    return linear.requires_grad_(stacked.weight.requires_grad)


def _cell(weight: Tensor, bias: Tensor, of_hidden: Tensor, hidden_bias: Tensor) -> nn.GRUCell:
    cell = nn.GRUCell(weight.shape[1], len(hidden_bias))
    cell.load_state_dict(_in_order_of_torch(weight, bias, of_hidden, hidden_bias))
    return cell


def _in_order_of_torch(
    weight: Tensor, bias: Tensor, of_hidden: Tensor, hidden_bias: Tensor
) -> dict[str, Tensor]:
    """The weights of a GRU for torch, whose order is r, u, n, and where all gates have two biases.

    Args:
        weight: of the inputs, [3H, I], in the order n, r, u.
        bias: [3H], in the same order.
        of_hidden: of h_t, [3H, H], in the order r, u, n.
        hidden_bias: of the gate n, [H].
    """
    size = len(hidden_bias)
    return {
        "weight_ih": weight.roll(-size, 0),
        "weight_hh": of_hidden,
        "bias_ih": bias.roll(-size),
        "bias_hh": torch.cat([hidden_bias.new_zeros(2 * size), hidden_bias]),
    }
