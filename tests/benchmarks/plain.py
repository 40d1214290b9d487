"""The models as one would write them with `torch.nn`, to compare with.

Same equations, same weights, same loss; only the recurrent networks differ. Where a state is fed
back there is a loop over the steps with a `GRUCell`, members one after the other; where none is, in
the encoder, a `GRU`, which is faster. Loops take sequences apart once (`unbind`): an index into
them at each step would cost the derivative a copy of the whole.
"""

from copy import deepcopy

import torch
from torch import Tensor, nn

from study.models import Model
from study.models.networks.cvae import RecurrentCvae
from study.models.networks.gaussian_decoder import GaussianDecoder
from study.models.residual_vae import ResidualVae
from study.models.rnn_ensemble import Ensemble, Members
from study.models.vae import Vae


def plain(model: Model) -> Model:
    """A copy whose recurrent networks are loops over `GRUCell`; free running alone."""
    copy = deepcopy(model)
    if isinstance(copy, Ensemble):
        copy.members = PlainMembers(copy.members)  # type: ignore[assignment]
    if isinstance(copy, Vae):
        copy.cvae = PlainCvae(copy.cvae)  # type: ignore[assignment]
    if isinstance(copy, ResidualVae):
        copy.ensemble.members = PlainMembers(copy.ensemble.members)  # type: ignore[assignment]
        copy.ensemble.requires_grad_(False)
    return copy


class PlainMembers(nn.Module):
    """`Members`, one after the other."""

    def __init__(self, members: Members) -> None:
        super().__init__()
        count = len(members.start.weight)
        self.members = nn.ModuleList(PlainMember(members, index) for index in range(count))

    def forward(self, s0: Tensor, actions: Tensor) -> Tensor:
        """ŝ_{1:T} [M, B, T, D] from s_0 [M, B, D] and a_{0:T-1} [M, B, T, A]."""
        each = zip(self.members, s0, actions, strict=True)
        return torch.stack([member(*given) for member, *given in each])


class PlainMember(nn.Module):
    """One of `Members`, with its weights."""

    delta_std: Tensor

    def __init__(self, members: Members, index: int) -> None:
        super().__init__()
        self.register_buffer("delta_std", members.delta_std)
        self.start = _linear(members.start.weight[index].T, members.start.bias[index, 0])
        self.cell = _cell(
            torch.cat([members.driven.weight, members.feed.weight], 1)[index].T,
            members.recurrent.weight[index].T,
            members.driven.bias[index, 0],
            members.recurrent.bias[index, 0],
        )
        self.out = _linear(members.out.weight[index].T, members.out.bias[index, 0])

    def forward(self, s0: Tensor, actions: Tensor) -> Tensor:
        """ŝ_{1:T} [B, T, D] from s_0 [B, D] and a_{0:T-1} [B, T, A]."""
        state, hidden, states = s0, torch.tanh(self.start(s0)), []
        for action in actions.unbind(1):
            hidden = self.cell(torch.cat([action, state], -1), hidden)
            state = state + self.out(hidden) * self.delta_std
            states.append(state)
        return torch.stack(states, dim=1)


class PlainCvae(nn.Module):
    """`RecurrentCvae`, with its weights. What its methods take and give is said there."""

    def __init__(self, cvae: RecurrentCvae) -> None:
        super().__init__()
        self.sees_target = cvae.sees_target
        self.encoder = _gru(
            cvae.encoder_driven.weight,
            cvae.encoder_recurrent.weight,
            cvae.encoder_driven.bias,
            cvae.encoder_recurrent.bias,
        )
        self.posterior, self.decode = cvae.posterior, PlainDecoder(cvae.decode)

    loss = RecurrentCvae.loss

    def encode(self, target: Tensor, states: Tensor, condition: Tensor) -> tuple[Tensor, Tensor]:
        """Mean and log variance of q_φ(z_t | ·)."""
        seen = [target, states, condition] if self.sees_target else [states, condition]
        hiddens, _ = self.encoder(torch.cat(seen, -1))
        mean, log_variance = self.posterior(hiddens).chunk(2, dim=-1)
        return mean, log_variance.clamp(-12.0, 6.0)


class PlainDecoder(nn.Module):
    """`GaussianDecoder`, with its weights. What its methods take and give is said there."""

    output_scale: Tensor
    variance: Tensor

    def __init__(self, decoder: GaussianDecoder) -> None:
        super().__init__()
        self.increments = decoder.increments
        self.register_buffer("output_scale", decoder.output_scale)
        self.register_buffer("variance", decoder.variance)
        self.cell = _cell(
            torch.cat([decoder.driven.weight, decoder.feed.weight], -1),
            decoder.recurrent.weight,
            decoder.driven.bias,
            decoder.recurrent.bias,
        )
        self.start, self.out, self.width = decoder.start, decoder.out, decoder.width

    remember = GaussianDecoder.remember

    def distribution(
        self, s0: Tensor, baseline: Tensor, condition: Tensor, latent: Tensor, truth: None = None
    ) -> tuple[Tensor, Tensor]:
        """ŝ_{1:T} and w_{1:T}, the decoder fed its own predictions."""
        assert truth is None
        return self.unroll(s0, baseline, condition, latent, torch.zeros_like(baseline[:, 1:]))

    def draw(
        self, s0: Tensor, baseline: Tensor, condition: Tensor, latent: Tensor, normal: Tensor
    ) -> Tensor:
        """s_{1:T}, each drawn and fed back."""
        return self.unroll(s0, baseline, condition, latent, normal * self.variance.sqrt())[0]

    def unroll(
        self, s0: Tensor, baseline: Tensor, condition: Tensor, latent: Tensor, noise: Tensor
    ) -> tuple[Tensor, Tensor]:
        """s_{1:T} and w_{1:T}; the noise is as wide as w says, and fed back."""
        state, states, widths = s0, [], []
        hidden = self.start(torch.cat([s0, condition[:, 0]], -1))
        x = s0 - baseline[:, 0]
        inputs = torch.cat([condition, latent], -1).unbind(1)
        given = zip(inputs, baseline[:, 1:].unbind(1), noise.unbind(1), strict=True)
        for entering, base, drawn in given:
            hidden = self.cell(torch.cat([entering, state], -1), hidden)
            output = self.out(hidden) * self.output_scale
            width = torch.tanh(self.width(hidden))
            x = (x + output if self.increments else output) + torch.exp(width) * drawn
            state = x + base
            states.append(state)
            widths.append(width)
        return torch.stack(states, dim=1), torch.stack(widths, dim=1)


def _linear(weight: Tensor, bias: Tensor) -> nn.Linear:
    linear = nn.Linear(weight.shape[1], weight.shape[0])
    linear.load_state_dict({"weight": weight, "bias": bias})
    return linear


def _cell(enter: Tensor, weight: Tensor, enter_bias: Tensor, bias: Tensor) -> nn.GRUCell:
    cell = nn.GRUCell(enter.shape[1], weight.shape[1])
    cell.load_state_dict(
        {"weight_ih": enter, "weight_hh": weight, "bias_ih": enter_bias, "bias_hh": bias}
    )
    return cell


def _gru(enter: Tensor, weight: Tensor, enter_bias: Tensor, bias: Tensor) -> nn.GRU:
    gru = nn.GRU(enter.shape[1], weight.shape[1], batch_first=True)
    given = {"weight_ih": enter, "weight_hh": weight, "bias_ih": enter_bias, "bias_hh": bias}
    gru.load_state_dict({f"{name}_l0": tensor for name, tensor in given.items()})
    return gru
