"""A GRU whose inputs are known for all steps: teacher forcing, and the encoder of a VAE."""

import warnings

import torch
from torch import Tensor

from study.models.precision import in_float32
from study.models.unroll.unroll import Weights, unroll

warnings.filterwarnings("ignore", "RNN module weights are not part of single contiguous chunk")


@in_float32
def gru(gates: Tensor, hidden: Tensor, weight: Tensor, bias: Tensor) -> Tensor:
    """h_{1:T} [M, B, T, H] of a GRU without a state that is fed back: see `unroll`.

    On a CPU it is `unroll`. On a GPU it is `library_gru`.

    Args:
        gates: what does not depend on h_t, in the order n, r, u, [M, B, T, 3H].
        hidden: h_0 [M, B, H].
        weight: from h_t to the gates r, u and n, [M, H, 3H].
        bias: of the gate n, [M, H].
    """
    if library_is_used(gates.device):
        return library_gru(gates, hidden, weight, bias)
    return unrolled_gru(gates, hidden, weight, bias)


def library_is_used(device: torch.device) -> bool:
    """Whether `gru` is `library_gru` on this device."""
    return device.type != "cpu"


def library_gru(gates: Tensor, hidden: Tensor, weight: Tensor, bias: Tensor) -> Tensor:
    """`gru` by `torch.gru`, which is cuDNN's on a GPU: all steps in one call.

    The library multiplies its inputs by a matrix. Here `gates` has the products already. So the
    matrix is a permutation, from the order n, r, u of the gates to the library's r, u, n. On a CPU
    the library is not faster than the loop of `torch_unroll`.
    """
    # By default cuDNN rounds the factors of its products to 10 bits (TF32). After a change of the
    # newer setting, which is for its GRU alone, torch refuses to read this one.
    torch.backends.cudnn.allow_tf32 = False
    size = bias.shape[1]
    permutation = torch.eye(3 * size, dtype=gates.dtype, device=gates.device).roll(-size, 0)
    no_bias = gates.new_zeros(3 * size)
    results = []
    for network, initial, of_hidden, of_n in zip(gates, hidden, weight, bias, strict=True):
        hidden_bias = torch.cat([no_bias[size:], of_n])
        parameters = [permutation, of_hidden.T.contiguous(), no_bias, hidden_bias]
        options = (True, 1, 0.0, torch.is_grad_enabled(), False, True)
        results.append(torch.gru(network, initial[None].contiguous(), parameters, *options)[0])
    return torch.stack(results)


def unrolled_gru(gates: Tensor, hidden: Tensor, weight: Tensor, bias: Tensor) -> Tensor:
    """`gru` by `unroll`: in C, or step by step in torch."""
    count, memory = bias.shape

    def empty(*shape: int) -> Tensor:
        return bias.new_zeros(count, *shape)

    none = bias.new_zeros(0)
    weights = Weights(
        state=empty(0, 3 * memory),
        gates=empty(0, 3 * memory),
        hidden=weight,
        hidden_bias=bias,
        mix=empty(0, 0),
        mix_bias=empty(0),
        layers=empty(0, memory, memory),
        layers_bias=empty(0, memory),
        output=empty(memory, 0),
        noise_output=None,
        log_std=None,
        log_std_bias=None,
        lowest=none,
        highest=none,
        angle_columns=none.long(),
        angle_mean=none,
        angle_scale=none,
        pair_columns=none.long(),
        axis_columns=none.long(),
        axis_scale=none,
    )
    return unroll(weights, gates, hidden[..., :0], hidden, return_tops=True)[1]
