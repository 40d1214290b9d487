"""The loss of equation (12), and what the encoder may depend on."""

import math

import numpy as np
import pytest
import torch
from torch.distributions import Normal, kl_divergence

from study.models.networks.cvae import RecurrentCvae, kl_from_standard_normal
from tests.helpers.models import ACTION, HORIZON, STATE


def test_the_loss_term_by_term() -> None:
    generator = np.random.default_rng(1)
    error, log_std = generator.normal(size=(2, 3, 4, STATE))
    mean, log_variance = generator.normal(size=(2, 3, 4, 5))
    beta = 0.3
    # The σ of each dimension under which the batch has the largest likelihood.
    scale = np.sqrt(np.square(error / np.exp(log_std)).mean(axis=(0, 1)))
    weight = np.exp(log_std) / np.exp(log_std).mean(axis=(0, 1))
    nll = divergence = 0.0
    for b in range(3):
        for t in range(4):
            for d in range(STATE):
                sigma = scale[d] * math.exp(log_std[b, t, d])
                minus_log = 0.5 * (error[b, t, d] / sigma) ** 2
                minus_log += math.log(sigma * math.sqrt(2 * math.pi))
                nll += weight[b, t, d] * minus_log
            for z in range(5):
                m, v = mean[b, t, z], math.exp(log_variance[b, t, z])
                divergence += 0.5 * (m**2 + v - 1 - math.log(v))
    nll, divergence = nll / 12, divergence / 12
    cvae = RecurrentCvae(torch.ones(STATE), ACTION, 8, 5).double()
    loss, found_nll, found_divergence, variance = cvae.loss(
        torch.from_numpy(error),
        torch.from_numpy(log_std),
        torch.from_numpy(mean),
        torch.from_numpy(log_variance),
        beta,
    )
    assert found_nll.item() == pytest.approx(nll)
    assert found_divergence.item() == pytest.approx(divergence)
    assert loss.item() == pytest.approx(nll + beta * divergence)
    np.testing.assert_allclose(variance, scale**2)


def test_the_kl_divergence_against_torch_distributions() -> None:
    torch.manual_seed(0)
    mean, log_variance = torch.randn(2, 6, 3).double().unbind(0)
    posterior = Normal(mean, torch.exp(0.5 * log_variance))
    prior = Normal(torch.zeros_like(mean), torch.ones_like(mean))
    expected = kl_divergence(posterior, prior).sum(-1)
    torch.testing.assert_close(kl_from_standard_normal(mean, log_variance), expected)


@pytest.mark.parametrize("uses_target", [True, False])
def test_the_encoder_is_causal(uses_target: bool) -> None:
    """It sees targets, states and conditions up to step t; without `uses_target` no targets."""
    torch.manual_seed(0)
    cvae = RecurrentCvae(torch.ones(STATE), ACTION, 8, 4, uses_target=uses_target)
    inputs = [torch.randn(2, HORIZON, size) for size in (STATE, STATE, ACTION)]
    reference, _ = cvae.encode(*inputs)
    for position in range(3):
        changed = [tensor.clone() for tensor in inputs]
        changed[position][:, 3] += 1.0
        mean, _ = cvae.encode(*changed)
        torch.testing.assert_close(mean[:, :3], reference[:, :3])
        is_input = uses_target or position > 0
        assert torch.allclose(mean[:, 3:], reference[:, 3:]) != is_input
