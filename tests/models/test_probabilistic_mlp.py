"""The probabilistic MLP: its likelihood, its sampling and its variance bounds."""

from typing import Any

import pytest
import torch
from torch.distributions import Normal

from tests.helpers.models import ACTION, HORIZON, STATE, model


@pytest.mark.parametrize("loss", ["nll", "beta_nll"])
def test_the_likelihood_against_torch_distributions(loss: str) -> None:
    network: Any = model("probabilistic_mlp", mlp={"loss": loss})
    torch.manual_seed(0)
    states, actions = torch.randn(4, HORIZON + 1, STATE), torch.randn(4, HORIZON, ACTION)
    losses = network.losses({"states": states, "actions": actions}, 0)
    mean, log_variance = network(states[:, :-1], actions)
    change = (states[:, 1:] - states[:, :-1]) / network.delta_std
    std = torch.exp(0.5 * log_variance)
    nll = -Normal(mean, std).log_prob(change)
    weight = std / std.mean((0, 1)) if loss == "beta_nll" else 1.0
    likelihood = (weight * nll).sum(-1).mean()
    bounds = network.max_log_variance.sum() - network.min_log_variance.sum()
    torch.testing.assert_close(losses["loss/negative_log_likelihood"], likelihood)
    torch.testing.assert_close(losses["loss"], likelihood + 0.01 * bounds)


def test_the_next_state_is_sampled_and_fed_back() -> None:
    network: Any = model("probabilistic_mlp")
    torch.manual_seed(0)
    s0, actions = torch.randn(2, STATE), torch.randn(2, HORIZON, ACTION)
    noise = torch.randn(2, 1, HORIZON, STATE)
    states = network.sample(s0, actions, noise, torch.zeros(2, 1, dtype=torch.int64))[:, 0]
    previous = s0
    for step in range(HORIZON):
        mean, log_variance = network(previous, actions[:, step])
        change = mean + torch.exp(0.5 * log_variance) * noise[:, 0, step]
        torch.testing.assert_close(states[:, step], previous + change * network.delta_std)
        previous = states[:, step]


def test_the_variance_is_bounded() -> None:
    network: Any = model("probabilistic_mlp")
    _, log_variance = network(torch.randn(50, STATE) * 1e4, torch.randn(50, ACTION) * 1e4)
    assert (log_variance <= network.max_log_variance + 1e-3).all()
    assert (log_variance >= network.min_log_variance - 1e-3).all()
