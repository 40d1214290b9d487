"""The encoder of a whole trajectory, and the prior that it estimates."""

import pytest
import torch
from torch import Tensor
from torch.distributions import Normal, kl_divergence

from study.models.networks.trajectory_encoder import (
    QUANTILES,
    RECENT,
    STEPS,
    UPDATE_EVERY,
    TrajectoryEncoder,
)

STATE, CONDITION, LATENT = 3, 2, 2


def encoder() -> TrajectoryEncoder:
    torch.manual_seed(0)
    built = TrajectoryEncoder(2 * STATE + CONDITION, LATENT)
    torch.nn.init.normal_(built.posterior.weight)
    return built


def trajectories(count: int, steps: int) -> list[Tensor]:
    return [torch.randn(count, steps, size) for size in (STATE, STATE, CONDITION)]


def test_samples_and_divergence_are_those_of_the_posterior() -> None:
    network = encoder()
    network.posterior.bias.data.copy_(torch.tensor([0.5, -1.0, 0.3, -0.7]))
    network.posterior.weight.data.mul_(0.01)
    inputs = [values[:1].expand(50_000, -1, -1) for values in trajectories(1, 4)]
    with torch.no_grad():
        samples, divergence = network(*inputs)
        hidden = network.network(torch.cat([values[:1] for values in inputs], -1)).mean(1)
        mean, log_variance = network.posterior(hidden)[0].chunk(2)
    std = torch.exp(0.5 * log_variance)
    torch.testing.assert_close(samples.mean(0), mean, rtol=0, atol=0.03)
    torch.testing.assert_close(samples.std(0), std, rtol=0.03, atol=0)
    prior = Normal(torch.zeros(LATENT), torch.ones(LATENT))
    expected = kl_divergence(Normal(mean, std), prior).sum()
    torch.testing.assert_close(divergence, expected.expand(50_000))


def test_the_order_of_the_steps_does_not_matter() -> None:
    network, inputs = encoder(), trajectories(4, STEPS)
    order = torch.randperm(STEPS)
    _, expected = network(*inputs)
    _, found = network(*(values[:, order] for values in inputs))
    torch.testing.assert_close(found, expected)


@pytest.mark.parametrize("position", range(3))
def test_it_depends_on_all_inputs_of_some_of_the_steps(position: int) -> None:
    network, inputs = encoder(), trajectories(4, 2 * STEPS + 1)
    _, expected = network(*inputs)
    for step, has_effect in ((0, True), (1, False), (2, False), (3, True)):
        changed = [values.clone() for values in inputs]
        changed[position][:, step] += 1.0
        _, found = network(*changed)
        assert torch.equal(found, expected) != has_effect


def test_the_prior_is_standard_normal_before_training() -> None:
    normal = torch.linspace(-1.5, 1.5, 50)[:, None].expand(-1, LATENT)
    torch.testing.assert_close(encoder().prior(normal), normal, rtol=0, atol=0.02)


def test_the_prior_is_the_distribution_of_the_latent_variable_in_training() -> None:
    """Here it has two modes in one component, and another scale in the other."""
    network = encoder()

    def sample(count: int) -> Tensor:
        normal = torch.randn(count, LATENT)
        mode = torch.randint(2, (count,)) * 2.0 - 1.0
        return torch.stack([2 * mode + 0.2 * normal[:, 0], 0.5 * normal[:, 1] + 1], 1)

    for step in range(UPDATE_EVERY + 1):
        network.update_prior(sample(200), step)
    assert len(network.recent) == RECENT
    found, expected = network.prior(torch.randn(20_000, LATENT)), sample(20_000)
    levels = torch.tensor([0.03, 0.1, 0.25, 0.45, 0.55, 0.75, 0.9, 0.97])
    ours, theirs = (torch.quantile(values, levels, dim=0) for values in (found, expected))
    torch.testing.assert_close(ours, theirs, rtol=0, atol=0.1)
    assert (found[:, 0].abs() < 1).float().mean() < 0.03
    # It is saved with the weights.
    loaded = encoder()
    loaded.load_state_dict(network.state_dict())
    extremes = torch.tensor([-40.0, 0.3, 40.0])[:, None].expand(-1, LATENT)
    assert torch.equal(loaded.prior(extremes), network.prior(extremes))
    torch.testing.assert_close(network.prior(extremes)[0], network.quantiles[0])
    torch.testing.assert_close(network.prior(extremes)[2], network.quantiles[-1])


def test_the_prior_is_estimated_at_intervals_from_recent_samples() -> None:
    network = encoder()
    initial = network.quantiles.clone()
    network.update_prior(torch.full((QUANTILES, LATENT), 3.0), 0)  # too few
    network.update_prior(torch.full((QUANTILES, LATENT), 3.0), UPDATE_EVERY - 1)
    assert torch.equal(network.quantiles, initial)
    network.update_prior(torch.full((1, LATENT), 3.0), UPDATE_EVERY)
    assert (network.quantiles == 3.0).all()
    network.update_prior(torch.full((RECENT, LATENT), 5.0), 2 * UPDATE_EVERY)
    assert (network.quantiles == 5.0).all()
