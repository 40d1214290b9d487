"""The models as one would write them with `torch.nn`, to compare with.

Equations, weights and loss are the same; only the recurrent networks differ. Where a state is fed
back there is a loop over the steps with a `GRUCell`, one member after the other. The encoder feeds
nothing back, and is a `GRU`, which is faster. Loops split sequences once (`unbind`): an index at
each step would cost the derivative a copy of the whole sequence.
"""

from copy import deepcopy

import torch
from torch import Tensor, nn

from study.models import Model
from study.models.networks.cvae import RecurrentCvae
from study.models.networks.decoder import GaussianDecoder
from study.models.networks.rnn import StackedRnn
from study.models.residual_vae import ResidualVae
from study.models.rnn_ensemble import RnnEnsemble
from study.models.vae import VaeModel


def plain(model: Model) -> Model:
    """A copy whose recurrent networks are loops over `GRUCell`, without teacher forcing."""
    copy = deepcopy(model)
    if isinstance(copy, RnnEnsemble):
        copy.members = PlainRnns(copy.members)  # type: ignore[assignment]
    if isinstance(copy, VaeModel):
        copy.cvae = PlainCvae(copy.cvae)  # type: ignore[assignment]
    if isinstance(copy, ResidualVae):
        assert copy.ensemble is not None
        copy.ensemble.members = PlainRnns(copy.ensemble.members)  # type: ignore[assignment]
        copy.ensemble.requires_grad_(False)
    return copy


class PlainRnns(nn.Module):
    """`StackedRnn`, one member after the other."""

    def __init__(self, stacked: StackedRnn) -> None:
        super().__init__()
        count = len(stacked.initial_hidden.weight)
        self.members = nn.ModuleList(PlainRnn(stacked, index) for index in range(count))

    def forward(self, s0: Tensor, actions: Tensor, truth: None = None) -> Tensor:
        """See `StackedRnn.forward`."""
        assert truth is None
        inputs = zip(self.members, s0, actions, strict=True)
        return torch.stack([member(start, plan) for member, start, plan in inputs])


class PlainRnn(nn.Module):
    """One member of `StackedRnn`, with its weights."""

    delta_std: Tensor

    def __init__(self, stacked: StackedRnn, index: int) -> None:
        super().__init__()
        self.register_buffer("delta_std", stacked.delta_std)
        initial, output = stacked.initial_hidden, stacked.output
        self.initial_hidden = _linear(initial.weight[index].T, initial.bias[index, 0])
        self.cell = _cell(
            torch.cat([stacked.gates_of_action.weight, stacked.gates_of_state.weight], 1)[index].T,
            stacked.gates_of_hidden.weight[index].T,
            stacked.gates_of_action.bias[index, 0],
            stacked.gates_of_hidden.bias[index, 0],
        )
        self.output = _linear(output.weight[index].T, output.bias[index, 0])

    def forward(self, s0: Tensor, actions: Tensor) -> Tensor:
        """ŝ_{1:T} [B, T, D] from s_0 [B, D] and a_{0:T-1} [B, T, A]."""
        state, hidden, states = s0, torch.tanh(self.initial_hidden(s0)), []
        for action in actions.unbind(1):
            hidden = self.cell(torch.cat([action, state], -1), hidden)
            state = state + self.output(hidden) * self.delta_std
            states.append(state)
        return torch.stack(states, dim=1)


class PlainCvae(nn.Module):
    """`RecurrentCvae`, with its weights and its methods."""

    def __init__(self, cvae: RecurrentCvae) -> None:
        super().__init__()
        self.uses_target = cvae.uses_target
        self.encoder = _gru(
            cvae.encoder_gates_of_input.weight,
            cvae.encoder_gates_of_hidden.weight,
            cvae.encoder_gates_of_input.bias,
            cvae.encoder_gates_of_hidden.bias,
        )
        self.posterior, self.decoder = cvae.posterior, PlainDecoder(cvae.decoder)

    loss = RecurrentCvae.loss

    def encode(self, target: Tensor, states: Tensor, condition: Tensor) -> tuple[Tensor, Tensor]:
        """See `RecurrentCvae.encode`."""
        inputs = [target, states, condition] if self.uses_target else [states, condition]
        hiddens, _ = self.encoder(torch.cat(inputs, -1))
        mean, log_variance = self.posterior(hiddens).chunk(2, dim=-1)
        return mean, log_variance.clamp(-12.0, 6.0)


class PlainDecoder(nn.Module):
    """`GaussianDecoder`, with its weights and its methods."""

    output_scale: Tensor
    variance: Tensor

    def __init__(self, decoder: GaussianDecoder) -> None:
        super().__init__()
        self.delta_target = decoder.delta_target
        self.register_buffer("output_scale", decoder.output_scale)
        self.register_buffer("variance", decoder.variance)
        self.cell = _cell(
            torch.cat([decoder.gates_of_input.weight, decoder.gates_of_state.weight], -1),
            decoder.gates_of_hidden.weight,
            decoder.gates_of_input.bias,
            decoder.gates_of_hidden.bias,
        )
        self.initial_hidden, self.output = decoder.initial_hidden, decoder.output
        self.log_std = decoder.log_std

    update_variance = GaussianDecoder.update_variance

    def forward(
        self, s0: Tensor, baseline: Tensor, condition: Tensor, latent: Tensor, truth: None = None
    ) -> tuple[Tensor, Tensor]:
        """See `GaussianDecoder.forward`."""
        assert truth is None
        return self._unroll(s0, baseline, condition, latent, torch.zeros_like(baseline[:, 1:]))

    def sample(
        self, s0: Tensor, baseline: Tensor, condition: Tensor, latent: Tensor, normal: Tensor
    ) -> Tensor:
        """See `GaussianDecoder.sample`."""
        return self._unroll(s0, baseline, condition, latent, normal * self.variance.sqrt())[0]

    def _unroll(
        self, s0: Tensor, baseline: Tensor, condition: Tensor, latent: Tensor, noise: Tensor
    ) -> tuple[Tensor, Tensor]:
        """States s_{1:T} and log standard deviations w_{1:T}; noise is scaled by exp(w)."""
        state, states, log_stds = s0, [], []
        hidden = self.initial_hidden(torch.cat([s0, condition[:, 0]], -1))
        x = s0 - baseline[:, 0]
        inputs = torch.cat([condition, latent], -1).unbind(1)
        steps = zip(inputs, baseline[:, 1:].unbind(1), noise.unbind(1), strict=True)
        for step_inputs, step_baseline, step_noise in steps:
            hidden = self.cell(torch.cat([step_inputs, state], -1), hidden)
            output = self.output(hidden) * self.output_scale
            log_std = torch.tanh(self.log_std(hidden))
            x = (x + output if self.delta_target else output) + torch.exp(log_std) * step_noise
            state = x + step_baseline
            states.append(state)
            log_stds.append(log_std)
        return torch.stack(states, dim=1), torch.stack(log_stds, dim=1)


def _linear(weight: Tensor, bias: Tensor) -> nn.Linear:
    linear = nn.Linear(weight.shape[1], weight.shape[0])
    linear.load_state_dict({"weight": weight, "bias": bias})
    return linear


def _cell(weight_ih: Tensor, weight_hh: Tensor, bias_ih: Tensor, bias_hh: Tensor) -> nn.GRUCell:
    cell = nn.GRUCell(weight_ih.shape[1], weight_hh.shape[1])
    cell.load_state_dict(
        {"weight_ih": weight_ih, "weight_hh": weight_hh, "bias_ih": bias_ih, "bias_hh": bias_hh}
    )
    return cell


def _gru(weight_ih: Tensor, weight_hh: Tensor, bias_ih: Tensor, bias_hh: Tensor) -> nn.GRU:
    network = nn.GRU(weight_ih.shape[1], weight_hh.shape[1], batch_first=True)
    tensors = {
        "weight_ih_l0": weight_ih,
        "weight_hh_l0": weight_hh,
        "bias_ih_l0": bias_ih,
        "bias_hh_l0": bias_hh,
    }
    network.load_state_dict(tensors)
    return network
