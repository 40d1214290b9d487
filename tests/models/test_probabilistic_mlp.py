"""The probabilistic MLP: its likelihood, and that it samples and feeds back."""

import pytest
import torch
from torch.distributions import Normal

from study.models.probabilistic_mlp import ProbabilisticMlp
from tests.helpers.models import ACTION, HORIZON, STATE, model


def mlp() -> ProbabilisticMlp:
    made = model("probabilistic_mlp")
    assert isinstance(made, ProbabilisticMlp)
    return made


@pytest.mark.parametrize("likelihood", ["plain", "weighted"])
def test_the_likelihood_against_torch_distributions(
    likelihood: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    network = mlp()
    network.settings["mlp"]["likelihood"] = likelihood
    logged: dict[str, torch.Tensor] = {}
    monkeypatch.setattr(network, "tell", logged.update)
    torch.manual_seed(0)
    states, actions = torch.randn(4, HORIZON + 1, STATE), torch.randn(4, HORIZON, ACTION)
    network.training_step({"states": states, "actions": actions})
    mean, log_variance = network(states[:, :-1], actions)
    change = (states[:, 1:] - states[:, :-1]) / network.delta_std
    scale = torch.exp(0.5 * log_variance)
    each = -Normal(mean, scale).log_prob(change)
    weight = scale / scale.mean((0, 1)) if likelihood == "weighted" else 1.0
    expected = (weight * each).sum(-1).mean()
    torch.testing.assert_close(logged["loss/negative_log_likelihood"].detach(), expected.detach())


def test_the_next_state_is_sampled_and_fed_back() -> None:
    network = mlp()
    torch.manual_seed(0)
    s0, actions = torch.randn(2, STATE), torch.randn(2, HORIZON, ACTION)
    noise = torch.randn(2, 1, HORIZON, STATE)
    states = network.sample(s0, actions, noise, torch.zeros(2, 1, dtype=torch.int64))[:, 0]
    before = s0
    for step in range(HORIZON):
        mean, log_variance = network(before, actions[:, step])
        change = mean + torch.exp(0.5 * log_variance) * noise[:, 0, step]
        torch.testing.assert_close(states[:, step], before + change * network.delta_std)
        before = states[:, step]


def test_the_variance_is_bounded() -> None:
    network = mlp()
    _, log_variance = network(torch.randn(50, STATE) * 1e4, torch.randn(50, ACTION) * 1e4)
    assert (log_variance <= network.highest + 1e-3).all()
    assert (log_variance >= network.lowest - 1e-3).all()
