"""The probabilistic MLPs against mbrl 0.2's `GaussianMLP`, with the same weights and batch.

mbrl's loss differs by convention, not in what it says. With D components, M members, and
n = (y − μ)² e^{−log σ²} + log σ² of each component,

    mbrl   Σ_m mean n               + 0.01 Σ_d (highest − lowest)     mean over batch and D; the
                                                                      members share their bounds
    ours   Σ_m [½ Σ_d (mean n + log 2π) + 0.01 Σ_d (highest − lowest)]

so that ours is −log p itself. Without the bounds' term ours = D/2 · (mbrl + M log 2π), and so are
the derivatives by the weights D/2 times mbrl's.
"""

import math
from typing import Any

import pytest
import torch
from torch import Tensor

from study.models.probabilistic_ensemble import ProbabilisticEnsemble
from tests.helpers.models import ACTION, HORIZON, STATE, model

mbrl = pytest.importorskip(
    "mbrl.models",
    reason="mbrl is not installed: `python -m tests.benchmarks.with_mbrl` does it for this test",
    exc_type=ImportError,
)
MEMBERS, HIDDEN, LAYERS = 3, 8, 2


def ours() -> ProbabilisticEnsemble:
    made = model("probabilistic_ensemble")
    assert isinstance(made, ProbabilisticEnsemble)
    made.settings["mlp"]["likelihood"] = "plain"  # as mbrl's; the members share these settings
    torch.manual_seed(3)
    highest, lowest = torch.rand(STATE), -3.0 + torch.rand(STATE)
    for member in made.each():
        # Not where they begin: there they would bound nothing.
        member.highest.data.copy_(highest)
        member.lowest.data.copy_(lowest)
    return made


def theirs(network: ProbabilisticEnsemble) -> Any:
    """mbrl's network with our weights."""
    peer = mbrl.GaussianMLP(
        STATE + ACTION,
        STATE,
        "cpu",
        num_layers=LAYERS,
        ensemble_size=MEMBERS,
        hid_size=HIDDEN,
        learn_logvar_bounds=True,
        activation_fn_cfg={"_target_": "torch.nn.SiLU"},
    )
    for place, layer in enumerate(linear_of(peer)):
        own = [member.network[2 * place] for member in network.each()]
        layer.weight.data = torch.stack([each.weight.data.T for each in own])
        layer.bias.data = torch.stack([each.bias.data[None] for each in own])
    peer.max_logvar.data = network.each()[0].highest.data[None].clone()
    peer.min_logvar.data = network.each()[0].lowest.data[None].clone()
    return peer


def linear_of(peer: Any) -> list[Any]:
    return [*(layer[0] for layer in peer.hidden_layers), peer.mean_and_logvar]


def given(network: ProbabilisticEnsemble) -> tuple[dict[str, Tensor], Tensor, Tensor]:
    """A batch, and its transitions as mbrl wants them: inputs and changes [M, B·T, ·]."""
    torch.manual_seed(4)
    states = torch.randn(MEMBERS, 5, HORIZON + 1, STATE)
    actions = torch.randn(MEMBERS, 5, HORIZON, ACTION)
    inputs = torch.cat([states[:, :, :-1], actions], dim=-1).flatten(1, 2)
    change = (states[:, :, 1:] - states[:, :, :-1]) / network.delta_std
    return {"states": states, "actions": actions}, inputs, change.flatten(1, 2)


def test_mean_and_variance() -> None:
    network = ours()
    _, inputs, _ = given(network)
    mean, log_variance = theirs(network)(inputs, use_propagation=False)
    bounded = 0
    for index, member in enumerate(network.each()):
        state, action = inputs[index].split([STATE, ACTION], dim=-1)
        own_mean, own_log_variance = member(state, action)
        torch.testing.assert_close(own_mean, mean[index])
        torch.testing.assert_close(own_log_variance, log_variance[index])
        free = member.network(inputs[index])[..., STATE:]
        bounded += int(((own_log_variance - free).abs() > 0.01).sum())
    assert bounded  # the bounds were at work


def test_loss_and_derivatives() -> None:
    network = ours()
    peer = theirs(network)
    batch, inputs, change = given(network)
    found = network.losses(batch, 0)["loss"]
    expected, _ = peer.loss(inputs, change)
    bounds = 0.01 * (peer.max_logvar.sum() - peer.min_logvar.sum())
    likelihood = STATE / 2 * (expected - bounds + MEMBERS * math.log(2 * math.pi))
    torch.testing.assert_close(found, likelihood + MEMBERS * bounds)
    found.backward()
    expected.backward()
    for place, layer in enumerate(linear_of(peer)):
        own = [member.network[2 * place] for member in network.each()]
        weight = torch.stack([each.weight.grad.T for each in own])
        bias = torch.stack([each.bias.grad[None] for each in own])
        torch.testing.assert_close(weight, STATE / 2 * layer.weight.grad, rtol=1e-4, atol=1e-6)
        torch.testing.assert_close(bias, STATE / 2 * layer.bias.grad, rtol=1e-4, atol=1e-6)
    # By the bounds: the likelihood's part as above, and 0.01 of each of ours against one of mbrl's.
    for ours_, peers, sign in (("highest", peer.max_logvar, 1), ("lowest", peer.min_logvar, -1)):
        total = torch.stack([getattr(member, ours_).grad for member in network.each()]).sum(0)
        of_likelihood = STATE / 2 * (peers.grad[0] - sign * 0.01)
        torch.testing.assert_close(total, of_likelihood + sign * 0.01 * MEMBERS)


def test_ts_infinity() -> None:
    """mbrl's `fixed_model` gives each row to one member; without noise its mean is the step."""
    network = ours()
    peer = theirs(network)
    peer.propagation_method = "fixed_model"
    rows = 4 * MEMBERS
    torch.manual_seed(5)
    s0, action = torch.randn(rows, STATE), torch.randn(rows, 1, ACTION)
    shuffled = torch.randperm(rows)
    mean, _ = peer(torch.cat([s0, action[:, 0]], -1), propagation_indices=shuffled)
    member = torch.empty(rows, dtype=torch.int64)
    member[shuffled] = torch.arange(rows) // (rows // MEMBERS)
    states = network.sample(s0, action, torch.zeros(rows, 1, 1, STATE), member[:, None])
    torch.testing.assert_close(states[:, 0, 0], s0 + mean * network.delta_std)
