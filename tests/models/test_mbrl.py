"""The probabilistic MLPs against mbrl 0.2's `GaussianMLP`, with the same weights and batch.

The networks are the same with one hidden layer, without product features, and with bounds of the
variances that are far away. There our w is small, since our bound is another function. Then

    mbrl   log σ² of a change in units of δ,   mean of the change in units of δ
    ours   2 (w + log σ − log δ),              the same mean

mbrl's loss has another normalisation. With D dimensions, M members, and
n = (y − μ)² e^{−log σ²} + log σ² of each dimension,

    mbrl   Σ_m mean n               + 0.01 Σ_d (highest − lowest)     mean over batch and D; the
                                                                      members share their bounds
    ours   Σ_m ½ Σ_d (mean n + log 2π + 2 log δ)

so that ours is −log p of the state. Without the term of the bounds, ours is
D/2 · (mbrl + M log 2π) + M Σ_d log δ, and the gradients of the weights are D/2 times mbrl's.
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
HIDDEN = SMALL.section("mlp").hidden_size
BOUND = 40.0
"""Of mbrl's log variance."""


def our_network() -> ProbabilisticMlpEnsemble:
    mlp, network = {"loss": "nll", "layers": 1}, {"features": "none"}
    built = model("probabilistic_ensemble", mlp=mlp, network=network)
    assert isinstance(built, ProbabilisticMlpEnsemble)
    torch.manual_seed(3)
    for member in built.member_models():
        member.network.log_std.weight.data.normal_(std=1e-3)
        member.network.stem.bias.data.normal_()
        member.network.output.bias.data.normal_()
    return built


def store_variance(network: ProbabilisticMlpEnsemble, batch: dict[str, Tensor]) -> Tensor:
    """Our loss, which also stores the variance of each member's batch."""
    return network.losses(batch, 0)["loss"]


def their_network(network: ProbabilisticMlpEnsemble) -> Any:
    """mbrl's network with our weights and variances."""
    peer = mbrl.GaussianMLP(
        STATE + ACTION,
        STATE,
        "cpu",
        num_layers=1,
        ensemble_size=MEMBERS,
        hid_size=HIDDEN,
        learn_logvar_bounds=True,
        activation_fn_cfg={"_target_": "torch.nn.SiLU"},
    )
    hidden, output = linear_layers(peer)
    networks = [member.network for member in network.member_models()]
    hidden.weight.data = torch.cat([member.stem.weight.data for member in networks])
    hidden.bias.data = torch.cat([member.stem.bias.data for member in networks])
    columns = [
        torch.cat([member.output.weight.data, 2 * member.log_std.weight.data], -1)
        for member in networks
    ]
    output.weight.data = torch.cat(columns)
    constants = [member.variance.log() - 2 * member.unit.log() for member in networks]
    biases = [
        torch.cat([member.output.bias.data, constant.expand(1, 1, -1)], -1)
        for member, constant in zip(networks, constants, strict=True)
    ]
    output.bias.data = torch.cat(biases)
    peer.max_logvar.data.fill_(BOUND)
    peer.min_logvar.data.fill_(-BOUND)
    return peer


def linear_layers(peer: Any) -> tuple[Any, Any]:
    (hidden,) = peer.hidden_layers
    return hidden[0], peer.mean_and_logvar


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
    batch, inputs, _ = transitions(network)
    store_variance(network, batch)
    mean, log_variance = their_network(network)(inputs, use_propagation=False)
    for index, member in enumerate(network.member_models()):
        state, action = (part[None, :, None] for part in inputs[index].split([STATE, ACTION], -1))
        predicted, log_std = member.network.predict(state, action, torch.zeros_like(state))
        our_mean = (predicted - state)[0, :, 0] / network.delta_std
        sigma = member.network.variance.sqrt() / network.delta_std
        torch.testing.assert_close(our_mean, mean[index], rtol=1e-4, atol=1e-4)
        our_log_variance = 2 * (log_std[0, :, 0] + sigma.log())
        torch.testing.assert_close(our_log_variance, log_variance[index])


def test_loss_and_gradients() -> None:
    network = our_network()
    batch, inputs, change = transitions(network)
    found = store_variance(network, batch)
    peer = their_network(network)
    expected, _ = peer.loss(inputs, change)
    bounds = 0.01 * (peer.max_logvar.sum() - peer.min_logvar.sum())
    likelihood = STATE / 2 * (expected - bounds + MEMBERS * math.log(2 * math.pi))
    torch.testing.assert_close(found, likelihood + MEMBERS * network.delta_std.log().sum())
    found.backward()
    expected.backward()
    hidden, output = linear_layers(peer)
    networks: list[Any] = [member.network for member in network.member_models()]
    of_mean, of_log_variance = slice(0, STATE), slice(STATE, None)
    for layer, theirs, columns, factor in (
        ("stem", hidden, slice(None), 1),
        ("output", output, of_mean, 1),
        ("log_std", output, of_log_variance, 2),  # log σ² has 2 w
    ):
        for part in ("weight", "bias"):
            ours = torch.cat([getattr(getattr(member, layer), part).grad for member in networks])
            gradient = STATE / 2 * factor * getattr(theirs, part).grad[..., columns]
            torch.testing.assert_close(ours, gradient, rtol=1e-3, atol=1e-4)
            # At the optimal σ² the bias of w has no gradient.
            assert (ours.abs().max() > 0.01) == ((layer, part) != ("log_std", "bias"))


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
