"""The probabilistic MLP: its likelihood, its sampling and the bounds of its variance."""

from typing import Any

import pytest
import torch
from torch import Tensor
from torch.distributions import Normal

from study.models.unroll.unroll import LOG_STD_BOUND
from tests.helpers.models import ACTION, HORIZON, STATE, batch, model

FEATURES = ["product", "none"]


def mlp(**changes: Any) -> Any:
    """A small MLP whose variance depends on the state, and with `product` its mean on s_0."""
    built: Any = model("probabilistic_mlp", **changes)
    if built.network.start_skip is not None:
        torch.nn.init.normal_(built.network.start_skip.weight)
    built.network.log_std.weight.data.normal_()
    built.network.variance.copy_(torch.tensor([0.5, 1.0, 2.0]))
    return built


def step(network: Any, state: Tensor, action: Tensor, s0: Tensor) -> tuple[Tensor, Tensor]:
    """Mean and log standard deviation w of one transition [B, D] of a trajectory from s_0."""
    zero = torch.zeros_like(state)[None, :, None]
    mean, log_std = network.network.predict(state[None, :, None], action[None, :, None], zero)
    mean, log_std = mean[0, :, 0], log_std[0, :, 0]
    if network.network.start_skip is None:
        return mean, log_std
    # A trajectory of one step begins at `state`.
    matrix = network.network.start_skip.weight[0]
    return mean + network.delta_std * ((s0 - state) @ matrix), log_std


@pytest.mark.parametrize("features", FEATURES)
@pytest.mark.parametrize("loss", ["nll", "beta_nll"])
def test_the_likelihood_against_torch_distributions(loss: str, features: str) -> None:
    network = mlp(mlp={"loss": loss}, network={"features": features})
    torch.manual_seed(0)
    states, actions = torch.randn(4, HORIZON + 1, STATE), torch.randn(4, HORIZON, ACTION)
    losses = network.losses({"states": states, "actions": actions}, 0)
    s0 = states[:, 0].repeat_interleave(HORIZON, 0)
    mean, log_std = step(network, states[:, :-1].flatten(0, 1), actions.flatten(0, 1), s0)
    after = states[:, 1:].flatten(0, 1)
    # The σ of the batch under which the likelihood is largest; the first batch stores it.
    sigma = ((after - mean) / log_std.exp()).square().mean(0).sqrt()
    torch.testing.assert_close(network.network.variance, sigma.detach() ** 2)
    nll = -Normal(mean, sigma * log_std.exp()).log_prob(after)
    weight = log_std.exp() / log_std.exp().mean(0) if loss == "beta_nll" else 1.0
    torch.testing.assert_close(losses["loss"], (weight * nll).sum(-1).mean())


def test_the_loss_of_a_transition_does_not_depend_on_the_others() -> None:
    """The network has no memory beside s_0: without it, trajectories of one step are the same."""
    network, data = mlp(), batch()
    torch.nn.init.zeros_(network.network.start_skip.weight)
    states = torch.stack([data["states"][:, :-1], data["states"][:, 1:]], 2)
    transitions = {
        "states": states.flatten(0, 1),
        "actions": data["actions"].flatten(0, 1)[:, None],
    }
    found, expected = (network.losses(values, 0)["loss"] for values in (transitions, data))
    torch.testing.assert_close(found, expected)


@pytest.mark.parametrize("features", FEATURES)
def test_the_next_state_is_sampled_and_fed_back(features: str) -> None:
    network = mlp(network={"features": features})
    torch.manual_seed(0)
    s0, actions = torch.randn(2, STATE), torch.randn(2, HORIZON, ACTION)
    noise = 0.1 * torch.randn(2, 1, HORIZON, STATE)
    states = network.sample(s0, actions, noise, torch.zeros(2, 1, dtype=torch.int64))[:, 0]
    previous = s0
    for t in range(HORIZON):
        mean, log_std = step(network, previous, actions[:, t], s0)
        std = network.network.variance.sqrt() * log_std.exp()
        torch.testing.assert_close(states[:, t], mean + std * noise[:, 0, t], rtol=1e-4, atol=1e-4)
        alone = network.step(previous, actions[:, t], noise[:, 0, t], s0)
        torch.testing.assert_close(states[:, t], alone, rtol=1e-4, atol=1e-4)
        previous = states[:, t]


def test_the_variance_is_bounded() -> None:
    state = torch.randn(50, STATE) * 1e4
    _, log_std = step(mlp(), state, torch.randn(50, ACTION) * 1e4, state)
    assert (log_std.abs() <= LOG_STD_BOUND).all()
    assert (log_std.abs() > 0.99 * LOG_STD_BOUND).any()


@pytest.mark.parametrize("features", FEATURES)
@pytest.mark.parametrize("layers", [1, 2, 4])
def test_the_number_of_hidden_layers(layers: int, features: str) -> None:
    """The stem is the first. There is no memory."""
    network = mlp(mlp={"layers": layers}, network={"features": features}).network
    parts = {"stem", "layers", "output", "log_std"}
    parts |= {"skip", "start_skip"} if features == "product" else set()
    assert {name for name, _ in network.named_children()} == parts
    assert len(network.layers) == layers - 1


@pytest.mark.parametrize("features", FEATURES)
def test_training_lowers_the_loss(features: str) -> None:
    network, data = mlp(network={"features": features}), batch()
    optimizer = torch.optim.Adam([p for p in network.parameters() if p.requires_grad], 1e-2)
    losses = []
    for number in range(40):
        loss = network.losses(data, number)["loss"]
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(float(loss.detach()))
    assert losses[-1] < losses[0] - 1.0


def test_forecasts_keep_to_the_range_of_the_training_data() -> None:
    network, states = mlp(), batch()["states"]
    network.on_training_data(states)
    noise = 100 * torch.randn(8, 1, HORIZON, STATE)
    actions, member = torch.randn(8, HORIZON, ACTION), torch.zeros(8, 1, dtype=torch.int64)
    forecasts = network.sample(states[:, 0], actions, noise, member)
    torch.testing.assert_close(forecasts.amax((0, 1, 2)), states.amax((0, 1)))
    torch.testing.assert_close(forecasts.amin((0, 1, 2)), states.amin((0, 1)))
