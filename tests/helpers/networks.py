"""Small dynamics networks with random weights."""

from dataclasses import replace
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from study.data.normalization import Normalization
from study.models.networks.architecture import Architecture
from study.models.networks.dynamics import DynamicsNetwork
from tests.helpers.models import ACTION, HORIZON, STATE, normalization

ROWS, WIDTH, START = 5, 8, 2


def units(rotating: bool = False) -> Normalization:
    """Units of a state; `rotating` makes its last component an angle."""
    pairs = np.array([[0, 1, 2]] if rotating else []).reshape(-1, 3).astype(np.int64)
    delta_std = np.array([0.1, 0.2, 0.3], np.float32)
    return replace(normalization(), rotating_pairs=pairs, delta_std=delta_std)


def architecture(memory: bool = True, product: bool = True, networks: int = 1) -> Architecture:
    """A small architecture."""
    start = START if memory else 0
    return Architecture(ACTION, WIDTH, memory, start, product=product, networks=networks)


@torch.no_grad()
def randomize(network: nn.Module) -> None:
    """Make the output depend on all inputs, as after training, with biases that are not zero."""
    for name, parameter in network.named_parameters():
        if parameter.requires_grad and name != "stem.weight":
            parameter.normal_(std=0.15)


def inputs(network: DynamicsNetwork) -> dict[str, Any]:
    """The arguments of a rollout, all random."""
    sizes, count = network.architecture, network.architecture.networks
    s0 = torch.randn(count, ROWS, STATE)
    return {
        "s0": s0,
        "inputs": torch.randn(count, ROWS, HORIZON, sizes.inputs),
        "offset": 0.1 * torch.randn(count, ROWS, HORIZON, STATE),
        "hidden": network.start(s0, torch.randn(count, ROWS, sizes.start)).detach(),
    }


def history_of(s0: Tensor, states: Tensor) -> Tensor:
    """s_{0:T-1} [M, B, T, D] of a rollout s_{1:T}."""
    return torch.cat([s0[:, :, None], states[:, :, :-1]], dim=2)
