"""Dynamics with normal noise: its samples have the variance of its likelihood."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from study.models.networks.architecture import Architecture
from study.models.networks.gaussian import VARIANCE_RATE, GaussianDynamics
from study.models.unroll.unroll import LOG_STD_BOUND
from tests.helpers.models import HORIZON, STATE
from tests.helpers.networks import ROWS, architecture, history_of, inputs, randomize, units

ARCHITECTURES = [
    architecture(memory=True),
    architecture(memory=False),
    architecture(memory=True, product=False),
    architecture(memory=False, product=False),
    replace(architecture(networks=2), delta=False),
]


def network(shape: Architecture, homoscedastic: bool = False) -> GaussianDynamics:
    torch.manual_seed(0)
    built = GaussianDynamics(units(True), shape, homoscedastic)
    randomize(built)
    built.variance.copy_(torch.tensor([0.04, 0.01, 0.0025]))
    return built


@pytest.mark.parametrize("shape", ARCHITECTURES)
def test_the_noise_of_a_sample_has_the_variance_of_the_likelihood(shape: Architecture) -> None:
    """Each state is sampled from p_θ and fed back."""
    dynamics = network(shape)
    values = inputs(dynamics)
    normal = torch.randn_like(values["offset"])
    sampled = dynamics.sample_rollout(**values, normal=normal)
    history = history_of(values.pop("s0"), sampled)
    mean, log_std = dynamics.predict(history, **values)
    assert log_std.std() > 0.1
    std = dynamics.variance.sqrt() * torch.exp(log_std)
    torch.testing.assert_close(sampled, mean + std * normal, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("shape", ARCHITECTURES)
def test_without_noise_a_sample_is_the_mean(shape: Architecture) -> None:
    dynamics = network(shape)
    values = inputs(dynamics)
    mean, log_std = dynamics.predict_rollout(**values)
    sampled = dynamics.sample_rollout(**values, normal=torch.zeros_like(mean))
    torch.testing.assert_close(sampled, mean)
    history = history_of(values.pop("s0"), mean)
    forced_mean, forced_log_std = dynamics.predict(history, **values)
    torch.testing.assert_close(forced_mean, mean, rtol=1e-4, atol=1e-5)
    torch.testing.assert_close(forced_log_std, log_std, rtol=1e-4, atol=1e-5)


def test_a_sample_from_a_later_state() -> None:
    """With the trajectory's s_0, the states are those of the whole sample."""
    dynamics = network(architecture(memory=False))
    values = inputs(dynamics)
    values["normal"] = torch.randn_like(values["offset"])
    sampled = dynamics.sample_rollout(**values)
    later = {name: values[name][:, :, 2:] for name in ("inputs", "offset", "normal")}
    found = dynamics.sample_rollout(sampled[:, :, 1], **later, start=values["s0"])
    torch.testing.assert_close(found, sampled[:, :, 2:])
    assert not torch.allclose(dynamics.sample_rollout(sampled[:, :, 1], **later), found)


def test_samples_in_blocks_are_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    dynamics = network(architecture())
    values = inputs(dynamics)
    normal = torch.randn_like(values["offset"])
    expected = dynamics.sample_rollout(**values, normal=normal)
    monkeypatch.setattr("study.models.networks.dynamics.MAX_ROWS", ROWS - 1)
    torch.testing.assert_close(dynamics.sample_rollout(**values, normal=normal), expected)


def test_the_log_standard_deviation_is_bounded() -> None:
    dynamics = network(architecture())
    dynamics.log_std.weight.data.mul_(1e8)
    values = inputs(dynamics)
    _, log_std = dynamics.predict_rollout(**values)
    torch.testing.assert_close(log_std.abs(), torch.full_like(log_std, LOG_STD_BOUND))
    # A small one is not changed.
    dynamics.log_std.weight.data.zero_()
    dynamics.log_std.bias.data.fill_(0.01 * LOG_STD_BOUND)
    _, log_std = dynamics.predict_rollout(**values)
    expected = torch.full_like(log_std, 0.01 * LOG_STD_BOUND)
    torch.testing.assert_close(log_std, expected, rtol=1e-4, atol=0)


@pytest.mark.parametrize("homoscedastic", [True, False])
def test_the_variance_is_learned_if_it_is_heteroscedastic(homoscedastic: bool) -> None:
    dynamics = GaussianDynamics(units(), architecture(), homoscedastic)
    mean, log_std = dynamics.predict_rollout(**inputs(dynamics))
    assert (log_std == 0).all()  # before training
    dynamics.nll(torch.randn_like(mean) - mean, log_std, 0).backward()
    gradient = dynamics.log_std.weight.grad
    assert dynamics.output.weight.grad is not None
    assert (gradient is None) == homoscedastic
    assert dynamics.log_std.weight.requires_grad != homoscedastic


@pytest.mark.parametrize("weighted", [True, False])
def test_the_likelihood_term_by_term(weighted: bool) -> None:
    generator = np.random.default_rng(1)
    error, log_std = generator.normal(size=(2, 3, 4, STATE))
    # The σ of each dimension under which the batch has the largest likelihood.
    scale = np.sqrt(np.square(error / np.exp(log_std)).mean(axis=(0, 1)))
    weight = np.exp(log_std) / np.exp(log_std).mean(axis=(0, 1))
    expected = 0.0
    for b in range(3):
        for t in range(4):
            for d in range(STATE):
                sigma = scale[d] * math.exp(log_std[b, t, d])
                minus_log = 0.5 * (error[b, t, d] / sigma) ** 2
                minus_log += math.log(sigma * math.sqrt(2 * math.pi))
                expected += (weight[b, t, d] if weighted else 1.0) * minus_log / 12
    dynamics: Any = GaussianDynamics(units(), architecture()).double()
    arrays = (torch.from_numpy(error), torch.from_numpy(log_std))
    assert dynamics.nll(*arrays, 0, weighted).item() == pytest.approx(expected)
    np.testing.assert_allclose(dynamics.variance, scale**2)


def test_the_variance_is_a_running_mean() -> None:
    """The first batch replaces it, and later ones move it; and it is saved with the weights."""
    dynamics = network(architecture())
    zero = torch.zeros(1, 2, HORIZON, STATE)
    std = torch.tensor([1.0, 2.0, 3.0])
    dynamics.nll(zero + std, zero, 0)
    torch.testing.assert_close(dynamics.variance, std**2)
    dynamics.nll(zero + 2 * std, zero, 1)
    torch.testing.assert_close(dynamics.variance, (0.5 + 0.5 * 4) * std**2)
    before = dynamics.variance.clone()
    # Errors are relative to e^w.
    dynamics.nll((zero + 3 * std) * math.e, zero + 1.0, 10**6)
    expected = (1 - VARIANCE_RATE) * before + VARIANCE_RATE * 9 * std**2
    torch.testing.assert_close(dynamics.variance, expected)
    assert "variance" in dynamics.state_dict()
