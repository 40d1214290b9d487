"""The probabilistic MLPs against mbrl 0.2's `GaussianMLP`, with the same weights and batch.

mbrl's loss has another normalisation. With D dimensions, M members, and
n = (y − μ)² e^{−log σ²} + log σ² of each dimension,

    mbrl   Σ_m mean n               + 0.01 Σ_d (highest − lowest)     mean over batch and D; the
                                                                      members share their bounds
    ours   Σ_m [½ Σ_d (mean n + log 2π) + 0.01 Σ_d (highest − lowest)]

so that ours is −log p. Without the term of the bounds ours = D/2 · (mbrl + M log 2π), and the
gradients of the weights are D/2 times mbrl's.
"""

import math
from typing import Any

import pytest
import torch
from torch import Tensor

from study.models.probabilistic_ensemble import ProbabilisticMlpEnsemble
from tests.helpers.models import ACTION, HORIZON, MEMBERS, SMALL, STATE, model

mbrl = pytest.importorskip(
    "mbrl.models",
    reason="mbrl is not installed; `python -m tests.benchmarks.with_mbrl` runs this test with it",
    exc_type=ImportError,
)
MLP = SMALL.section("mlp")
HIDDEN, LAYERS = MLP.hidden_size, MLP.layers


def our_network() -> ProbabilisticMlpEnsemble:
    network = model("probabilistic_ensemble", mlp={"loss": "nll"})
    assert isinstance(network, ProbabilisticMlpEnsemble)
    torch.manual_seed(3)
    highest, lowest = torch.rand(STATE), -3.0 + torch.rand(STATE)
    for member in network.member_models():
        # Not the initial values, with which no variance reaches a bound.
        member.max_log_variance.data.copy_(highest)
        member.min_log_variance.data.copy_(lowest)
    return network


def their_network(network: ProbabilisticMlpEnsemble) -> Any:
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
    for index, layer in enumerate(linear_layers(peer)):
        stacked: list[Any] = [member.network[2 * index] for member in network.member_models()]
        layer.weight.data = torch.stack([linear.weight.data.T for linear in stacked])
        layer.bias.data = torch.stack([linear.bias.data[None] for linear in stacked])
    first = network.member_models()[0]
    peer.max_logvar.data = first.max_log_variance.data[None].clone()
    peer.min_logvar.data = first.min_log_variance.data[None].clone()
    return peer


def linear_layers(peer: Any) -> list[Any]:
    return [*(layer[0] for layer in peer.hidden_layers), peer.mean_and_logvar]


def transitions(network: ProbabilisticMlpEnsemble) -> tuple[dict[str, Tensor], Tensor, Tensor]:
    """A batch, and its transitions in the form of mbrl: inputs and changes [M, B·T, ·]."""
    torch.manual_seed(4)
    states = torch.randn(MEMBERS, 5, HORIZON + 1, STATE)
    actions = torch.randn(MEMBERS, 5, HORIZON, ACTION)
    inputs = torch.cat([states[:, :, :-1], actions], dim=-1).flatten(1, 2)
    change = (states[:, :, 1:] - states[:, :, :-1]) / network.delta_std
    return {"states": states, "actions": actions}, inputs, change.flatten(1, 2)


def test_mean_and_variance() -> None:
    network = our_network()
    _, inputs, _ = transitions(network)
    mean, log_variance = their_network(network)(inputs, use_propagation=False)
    bounded = 0
    for index, member in enumerate(network.member_models()):
        state, action = inputs[index].split([STATE, ACTION], dim=-1)
        our_mean, our_log_variance = member(state, action)
        torch.testing.assert_close(our_mean, mean[index])
        torch.testing.assert_close(our_log_variance, log_variance[index])
        unbounded = member.network(inputs[index])[..., STATE:]
        bounded += int(((our_log_variance - unbounded).abs() > 0.01).sum())
    assert bounded


def test_loss_and_gradients() -> None:
    network = our_network()
    peer = their_network(network)
    batch, inputs, change = transitions(network)
    found = network.losses(batch, 0)["loss"]
    expected, _ = peer.loss(inputs, change)
    bounds = 0.01 * (peer.max_logvar.sum() - peer.min_logvar.sum())
    likelihood = STATE / 2 * (expected - bounds + MEMBERS * math.log(2 * math.pi))
    torch.testing.assert_close(found, likelihood + MEMBERS * bounds)
    found.backward()
    expected.backward()
    for index, layer in enumerate(linear_layers(peer)):
        stacked: list[Any] = [member.network[2 * index] for member in network.member_models()]
        weight = torch.stack([linear.weight.grad.T for linear in stacked])
        bias = torch.stack([linear.bias.grad[None] for linear in stacked])
        torch.testing.assert_close(weight, STATE / 2 * layer.weight.grad, rtol=1e-4, atol=1e-6)
        torch.testing.assert_close(bias, STATE / 2 * layer.bias.grad, rtol=1e-4, atol=1e-6)
    # Of the bounds: the likelihood's part as above, and 0.01 for each member against 0.01 once.
    members: list[Any] = network.member_models()
    for name, of_peer, sign in (
        ("max_log_variance", peer.max_logvar.grad[0], 1),
        ("min_log_variance", peer.min_logvar.grad[0], -1),
    ):
        gradient = torch.stack([getattr(member, name).grad for member in members]).sum(0)
        expected = STATE / 2 * (of_peer - sign * 0.01) + sign * 0.01 * MEMBERS
        torch.testing.assert_close(gradient, expected)


def test_ts_infinity() -> None:
    """mbrl's `fixed_model` assigns each row to one member; without noise its mean is the step."""
    network = our_network()
    peer = their_network(network)
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
