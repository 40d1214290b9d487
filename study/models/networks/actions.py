"""What a network sees of the actions."""

import torch
from torch import Tensor

from study.config.model_sections import Network

SUM_SCALE = 0.1
"""Factor on the sum of past actions, which grows over the horizon."""


def action_inputs_size(network: Network, action_size: int) -> int:
    """The last axis of `action_inputs`."""
    return 2 * action_size if network.action_sum else action_size


def action_inputs(network: Network, actions: Tensor) -> Tensor:
    """a_t and, with `network.action_sum`, the sum of all past actions Σ_{τ<t} a_τ, [..., T, C].

    A controller that integrates an error, such as an autopilot's, depends on past set-points. The
    difference between their sum and the distance travelled is that integral.

    Args:
        network: the settings.
        actions: a_{0:T-1} [..., T, A].
    """
    if not network.action_sum:
        return actions
    past = actions.cumsum(-2) - actions
    return torch.cat([actions, SUM_SCALE * past], -1)
