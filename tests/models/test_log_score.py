"""The log score of models with a density, against torch distributions and by integration."""

from typing import Any

import numpy as np
import pytest
import torch
from torch.distributions import Normal

from study.models.log_score import log_scores
from tests.helpers.models import ACTION, HORIZON, MEMBERS, STATE, model


def rollouts(count: int = 5) -> tuple[torch.Tensor, torch.Tensor]:
    torch.manual_seed(1)
    return torch.randn(count, HORIZON + 1, STATE), torch.randn(count, HORIZON, ACTION)


def randomized(name: str, **changes: Any) -> Any:
    built: Any = model(name, **changes)
    torch.manual_seed(2)
    for parameter in built.parameters():
        parameter.data.normal_(std=0.3)
    return built


def test_the_density_of_the_mlp_is_that_of_its_samples() -> None:
    """Samples of the first step have the mean and the standard deviation of the density."""
    network = randomized("probabilistic_mlp")
    states, actions = rollouts(1)
    normal = torch.randn(1, 40_000, HORIZON, STATE)
    member = torch.zeros(1, 40_000, dtype=torch.long)
    samples = network.sample(states[:, 0], actions, normal, member)[0, :, 0]
    estimate = Normal(samples.mean(0), samples.std(0)).log_prob(states[0, 1]).sum()
    density = network.log_density(states, actions)[0, 0]
    torch.testing.assert_close(density, estimate, atol=0.1, rtol=0.02)


@pytest.mark.parametrize("propagation", ["trajectory", "step"])
def test_the_density_of_an_ensemble_is_that_of_the_mixture(propagation: str) -> None:
    changes = {"probabilistic_ensemble": {"propagation": propagation}}
    network = randomized("probabilistic_ensemble", **changes)
    states, actions = rollouts()
    each = torch.stack([m.log_density(states, actions) for m in network.member_models()]).double()
    found = network.log_density(states, actions).double()
    if propagation == "step":
        expected = each.exp().mean(0).log()
        torch.testing.assert_close(found, expected, atol=1e-4, rtol=1e-4)
    else:  # of the whole trajectory
        expected = each.sum(-1).logsumexp(0) - np.log(MEMBERS)
        torch.testing.assert_close(found.sum(-1), expected, atol=1e-3, rtol=1e-4)


def test_a_better_model_has_a_lower_log_score_and_others_have_none() -> None:
    class Scenarios:
        """Three scenarios whose states change by nothing."""

        s0 = np.zeros((3, STATE), np.float32)
        observed = np.zeros((3, 1, HORIZON, STATE), np.float32)
        actions = np.zeros((3, HORIZON, ACTION), np.float32)

    test: Any = Scenarios()
    network: Any = model("probabilistic_mlp")
    network.network.variance.fill_(0.1)
    good = log_scores(network, test)
    network.network.output.bias.data.fill_(50.0)  # a change of 50 δ at each step
    bad = log_scores(network, test)
    assert good is not None
    assert bad is not None
    assert good.shape == (3, HORIZON)
    assert good.mean() < bad.mean()
    assert log_scores(model("full_vae"), test) is None
