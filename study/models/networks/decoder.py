"""The recurrent decoder of Figure 2 (right), which both VAEs use."""

import torch
from torch import Tensor, nn

from study.models.gru.recurrence import feedback_gru, gru


class GaussianDecoder(nn.Module):
    """p_θ(s_{t+1} | ŝ_{0:t}; c_{0:t}; z_{0:t}) = N(ŝ_{t+1}, σ² exp(2 w_{t+1})).

    The decoder generates a *target* x̂, which is added to a *baseline* b:

        h_0 = tanh([s_0, c_0] W_0 + b_0)
        h_{t+1} = GRU([c_t, z_t, ŝ_t], h_t)
        ŝ_{t+1} = b_{t+1} + u · (h_{t+1} W_o + b_o)                     target is the state
        ŝ_{t+1} = b_{t+1} + (ŝ_t − b_t) + u · (h_{t+1} W_o + b_o)       target is its change
        w_{t+1} = tanh(h_{t+1} W_w + b_w)

    σ² has one value for each dimension: the mean of the squared errors of training, each divided by
    exp(2 w). w makes the variance heteroscedastic: larger for a flight in wind than for a ball at
    rest, for example. w is bounded, so that noise that is fed back cannot grow without limit.

    The decoder is causal: its output at step t depends on no later state, condition or latent
    variable.

    Args:
        output_scale: u, the unit of the output in each dimension, [D].
        condition_size: C.
        hidden_size: H.
        latent_size: Z.
        delta_target: whether the output is x_{t+1} − x_t instead of x_{t+1}.
        homoscedastic: whether w is always 0.
    """

    output_scale: Tensor
    variance: Tensor
    """σ² [D], a running mean over batches: see `update_variance`."""

    def __init__(
        self,
        output_scale: Tensor,
        condition_size: int,
        hidden_size: int,
        latent_size: int,
        delta_target: bool = False,
        homoscedastic: bool = False,
    ) -> None:
        super().__init__()
        state_size = len(output_scale)
        self.delta_target = delta_target
        self.register_buffer("output_scale", output_scale.clone())
        self.register_buffer("variance", torch.ones_like(output_scale))
        initial = nn.Linear(state_size + condition_size, hidden_size)
        self.initial_hidden = nn.Sequential(initial, nn.Tanh())
        self.gates_of_input = nn.Linear(condition_size + latent_size, 3 * hidden_size)
        self.gates_of_state = nn.Linear(state_size, 3 * hidden_size, bias=False)
        self.gates_of_hidden = nn.Linear(hidden_size, 3 * hidden_size)
        self.output = nn.Linear(hidden_size, state_size)
        self.log_std = nn.Linear(hidden_size, state_size)
        nn.init.zeros_(self.log_std.weight)
        nn.init.zeros_(self.log_std.bias)
        self.log_std.requires_grad_(not homoscedastic)

    def forward(
        self,
        s0: Tensor,
        baseline: Tensor,
        condition: Tensor,
        latent: Tensor,
        truth: Tensor | None = None,
    ) -> tuple[Tensor, Tensor]:
        """The means ŝ_{1:T} and the log standard deviations w_{1:T}, relative to σ: [B, T, D] each.

        Args:
            s0: [B, D].
            baseline: b_{0:T} [B, T+1, D].
            condition: c_{0:T-1} [B, T, C].
            latent: z_{0:T-1} [B, T, Z].
            truth: s_{0:T-1} [B, T, D], the state history with teacher forcing. If None, the state
                history is the decoder's own means.
        """
        hiddens, mean = self._unroll(s0, baseline, condition, latent, truth)
        return mean, torch.tanh(self.log_std(hiddens))

    @torch.no_grad()
    def sample(
        self, s0: Tensor, baseline: Tensor, condition: Tensor, latent: Tensor, normal: Tensor
    ) -> Tensor:
        """Sampled states s_{1:T} [B, T, D]. Each state is sampled from p_θ and fed back.

        Args:
            s0, baseline, condition, latent: see `forward`.
            normal: standard normal numbers [B, T, D].
        """
        noise = normal * self.variance.sqrt()
        return self._unroll(s0, baseline, condition, latent, noise=noise)[1]

    def update_variance(self, variance: Tensor, rate: float) -> None:
        """Move the running mean σ² towards a batch's σ² [D] by the fraction `rate`.

        The loss uses the optimal σ² of each batch. Forecasts need σ² of all data.
        """
        self.variance.lerp_(variance, rate)

    def _unroll(
        self,
        s0: Tensor,
        baseline: Tensor,
        condition: Tensor,
        latent: Tensor,
        truth: Tensor | None = None,
        noise: Tensor | None = None,
    ) -> tuple[Tensor, Tensor]:
        """Hidden states h_{1:T} and states s_{1:T}; with noise, h may be empty."""
        hidden = self.initial_hidden(torch.cat([s0, condition[:, 0]], -1))
        inputs = torch.cat([condition, latent], -1)
        weight_ih = torch.cat([self.gates_of_input.weight, self.gates_of_state.weight], -1).T
        weight_hh = self.gates_of_hidden.weight.T
        bias = torch.stack([self.gates_of_input.bias, self.gates_of_hidden.bias])
        weight_ho = self.output.weight.T * self.output_scale
        residual = float(self.delta_target)
        # ŝ = x̂ + b, so a change of x̂ needs the change of b as well.
        offset = baseline[:, 1:] - baseline[:, :-1] if self.delta_target else baseline[:, 1:]
        offset = offset + self.output.bias * self.output_scale
        if truth is not None:
            hiddens = gru(torch.cat([inputs, truth], -1), hidden, weight_ih, weight_hh, bias)
            return hiddens, residual * truth + hiddens @ weight_ho + offset
        arguments = (inputs, offset, hidden, s0, weight_ih, weight_hh, bias, weight_ho, residual)
        if noise is None:
            return feedback_gru(*arguments, return_hiddens=True)
        log_std_weight = torch.cat([self.log_std.weight.T, self.log_std.bias[None]])
        return feedback_gru(*arguments, log_std_weight, noise)
