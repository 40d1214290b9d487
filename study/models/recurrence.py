"""One step of a gated recurrent unit, for networks whose loop over time must be taken apart."""

import torch
from torch import Tensor


def gru_cell(inputs: Tensor, recurrent: Tensor, hidden: Tensor) -> Tensor:
    """h_{t+1} of a GRU (Cho et al. 2014, in the form of `torch.nn.GRU`).

        r, u = σ(inputs + recurrent),  n = tanh(inputs + r · recurrent),  h' = (1 − u) n + u h

    Args:
        inputs: what drives the gates r, u and the candidate n, [..., 3H].
        recurrent: the same of the hidden state, [..., 3H].
        hidden: h_t [..., H].
    """
    size = hidden.shape[-1]
    gates = torch.sigmoid(inputs[..., : 2 * size] + recurrent[..., : 2 * size])
    reset, update = gates.chunk(2, dim=-1)
    candidate = torch.tanh(inputs[..., 2 * size :] + reset * recurrent[..., 2 * size :])
    return torch.lerp(candidate, hidden, update)
