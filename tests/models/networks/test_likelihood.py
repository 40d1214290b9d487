"""The Gaussian likelihoods against torch.distributions, scipy and their definitions."""

import numpy as np
import torch
from scipy.stats import norm
from torch import Tensor
from torch.distributions import Normal

from study.models.networks.likelihood import (
    gaussian_nll,
    heteroscedastic_nll,
    optimal_variance_nll,
    projected_log_score,
    weighted_log_score,
)


def test_gaussian_nll_against_torch_distributions() -> None:
    torch.manual_seed(0)
    error, log_variance = torch.randn(2, 50, 3).double().unbind(0)
    found = gaussian_nll(error.square() / log_variance.exp(), log_variance)
    expected = -Normal(torch.zeros_like(error), (0.5 * log_variance).exp()).log_prob(error)
    torch.testing.assert_close(found, expected)


def test_the_optimal_variance_has_the_smallest_nll() -> None:
    torch.manual_seed(0)
    truth, mean = torch.randn(2, 50, 3).double().unbind(0)
    squares = (truth - mean).square().mean(0)
    found = optimal_variance_nll(squares)

    def nll_at(std: Tensor) -> Tensor:
        return -Normal(mean, std).log_prob(truth).mean(0)

    torch.testing.assert_close(found, nll_at(squares.sqrt()))
    for factor in (0.9, 1.1):
        assert (nll_at(factor * squares.sqrt()) > found).all()


def test_the_gradient_does_not_depend_on_the_unit_of_a_dimension() -> None:
    squares = torch.tensor([0.3, 1.2, 2.0]).double().requires_grad_()
    unit = torch.tensor([1e-3, 1.0, 50.0]).double()
    (gradient,) = torch.autograd.grad(optimal_variance_nll(squares * unit**2).sum(), squares)
    torch.testing.assert_close(gradient, 0.5 / squares.detach())


def test_with_equal_variances_the_heteroscedastic_nll_is_the_homoscedastic_one() -> None:
    torch.manual_seed(0)
    error = torch.randn(6, 5, 3).double().requires_grad_()
    found, variance = heteroscedastic_nll(error, torch.zeros_like(error))
    expected = optimal_variance_nll(error.square().mean((0, 1)))
    torch.testing.assert_close(found, expected)
    torch.testing.assert_close(variance, error.detach().square().mean((0, 1)))
    ours, theirs = (torch.autograd.grad(nll.sum(), error)[0] for nll in (found, expected))
    torch.testing.assert_close(ours, theirs)


def test_the_heteroscedastic_nll_is_minimal_at_the_true_variances() -> None:
    """The weights of the β-NLL do not move the minimum."""
    torch.manual_seed(0)
    true_std = torch.tensor([0.5, 1.0, 2.0]).double()
    error = torch.randn(10_000, 3, 1).double() * true_std[:, None]
    log_std = torch.zeros(3, 1).double().requires_grad_()
    optimizer = torch.optim.Adam([log_std], 0.05)
    for _ in range(200):
        nll, variance = heteroscedastic_nll(error, log_std.expand_as(error))
        optimizer.zero_grad()
        nll.sum().backward()
        optimizer.step()
    std = variance.sqrt() * torch.exp(log_std.detach()[:, 0])
    torch.testing.assert_close(std, true_std, rtol=0.03, atol=0.0)


def test_transitions_with_a_large_variance_have_a_large_weight_in_the_log_score() -> None:
    """In proportion to the standard deviation to the power 3/4."""
    error, std = torch.tensor([[1.0], [3.0]]), torch.tensor([[0.5], [8.0]])
    weight = (std / std.mean()) ** 0.75
    score = 0.5 * (error / std) ** 2 + std.log()
    expected = (weight * score).sum() / weight.sum()
    torch.testing.assert_close(weighted_log_score(error, std.square()), expected)


def test_with_equal_variances_the_log_score_is_that_of_scipy() -> None:
    error = np.random.default_rng(0).normal(size=(50, 3))
    std = np.array([0.5, 2.0, 1.0])
    found = weighted_log_score(torch.from_numpy(error), torch.from_numpy(std**2).expand(50, 3))
    expected = -norm.logpdf(error, scale=std).mean() - 0.5 * np.log(2 * np.pi)
    np.testing.assert_allclose(found, expected)


def test_the_log_score_is_minimal_at_the_true_variances() -> None:
    """Also where transitions with two variances are weighted against each other."""
    std = torch.tensor([0.2, 3.0]).double().repeat(200_000)[:, None]
    generator = torch.Generator().manual_seed(0)
    error = std * torch.randn(std.shape, generator=generator, dtype=torch.float64)
    factors = torch.tensor([1.0, 1.0], dtype=torch.float64, requires_grad=True)
    predicted = std * factors.repeat(200_000)[:, None]
    weighted_log_score(error, predicted.square()).backward()
    assert factors.grad is not None
    assert factors.grad.abs().max() < 0.005
    wrong = weighted_log_score(error, (2 * std).square())
    right = weighted_log_score(error, std.square())
    assert float(wrong - right) > 0.1


def correlated(count: int) -> tuple[Tensor, Tensor]:
    """Errors of normal distributions N(0, GᵀG), and G [B, Z, D], of two different distributions."""
    torch.manual_seed(0)
    factors = torch.tensor([[[1.0, 0.9], [0.0, 0.4]], [[3.0, -1.0], [0.0, 2.0]]])
    factor = factors.repeat(count // 2, 1, 1)
    return torch.einsum("bz,bzd->bd", torch.randn(count, 2), factor), factor


def test_the_projected_log_score_is_minimal_at_the_true_correlation() -> None:
    error, factor = correlated(100_000)
    uncorrelated = torch.diag_embed(factor.square().sum(1).sqrt())
    reverse = factor * torch.tensor([1.0, -1.0])

    def score(values: Tensor) -> float:
        torch.manual_seed(1)
        return float(projected_log_score(error, values))

    assert score(factor) < score(uncorrelated) - 0.05
    assert score(uncorrelated) < score(reverse) - 0.05
    # Another factor of the same covariance has the same score.
    rotation = torch.linalg.qr(torch.randn(2, 2))[0]
    assert abs(score(rotation @ factor) - score(factor)) < 1e-4
    factor.requires_grad_()
    projected_log_score(error, factor).backward()
    assert factor.grad is not None
    assert factor.grad.sum(0).abs().max() < 0.01


def test_the_projected_log_score_does_not_depend_on_units() -> None:
    error, factor = correlated(1000)
    units = torch.tensor([1e-3, 20.0])
    scores = []
    for unit in (torch.ones(2), units):
        torch.manual_seed(1)
        scores.append(projected_log_score(error * unit, factor * unit))
    torch.testing.assert_close(scores[1], scores[0], rtol=1e-4, atol=1e-5)


def test_the_projected_log_score_does_not_train_the_mean() -> None:
    error, factor = correlated(1000)
    for values in (error, factor):
        values.requires_grad_()
    projected_log_score(error, factor).backward()
    assert error.grad is None
    assert factor.grad is not None
