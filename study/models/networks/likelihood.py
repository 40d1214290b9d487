"""The Gaussian negative log-likelihoods that the models minimise."""

import math

import torch
from torch import Tensor

from study.models.precision import in_float32

STD_POWER = 0.75
"""Exponent of the standard deviation in the weights of `weighted_log_score`."""

PROJECTIONS = 16
"""Directions of `projected_log_score`."""

MIN_VARIANCE = 1e-10
"""Smallest variance of an error. It keeps the logarithm finite."""


def gaussian_nll(standardized_square: Tensor, log_variance: Tensor) -> Tensor:
    """−log N(e; 0, σ²) = ½ (e² / σ² + log σ² + log 2π), elementwise.

    Args:
        standardized_square: e² / σ² [...].
        log_variance: log σ² [...].

    Returns:
        [...]
    """
    return 0.5 * (standardized_square + log_variance + math.log(2 * math.pi))


def optimal_variance_nll(squared_error: Tensor) -> Tensor:
    """−log N(s; ŝ, σ²) averaged over a batch, at the σ² that minimises it: E(s − ŝ)².

        min_σ ½ E(s − ŝ)² / σ² + log σ + ½ log 2π = ½ (log E(s − ŝ)² + 1 + log 2π)

    (Rybkin, Daniilidis and Levine, ICML 2021: the optimal σ-VAE.) The gradient of a logarithm is
    relative. So dimensions whose noise differs by orders of magnitude have equal weight from the
    first step on. A learned σ would first have to reach these orders of magnitude.

    Args:
        squared_error: E(s − ŝ)², the mean over the batch, [...].

    Returns:
        [...]
    """
    log_variance = squared_error.clamp(min=MIN_VARIANCE).log()
    return gaussian_nll(torch.ones_like(log_variance), log_variance)


def heteroscedastic_nll(
    error: Tensor, log_std: Tensor, weighted: bool = True
) -> tuple[Tensor, Tensor]:
    """The β-NLL of errors with standard deviation σ e^w, at the optimal σ of the batch.

        E[e^w (½ (s − ŝ)² / (σ² e^2w) + w + log σ + ½ log 2π)] / E e^w,   σ² = E[(s − ŝ)² / e^2w]

    where weights and σ have no gradient (Seitzer et al., ICLR 2022). Their β is ½ here; it is not
    the β of equation (12). Without the weights, a step whose error is first explained as noise has
    little influence, and is never learned. With w = 0, the value and its gradient by the error are
    those of `optimal_variance_nll`.

    Args:
        error: s − ŝ [..., D].
        log_std: w [..., D].
        weighted: whether there are weights; if not, it is the negative log-likelihood.

    Returns:
        the loss and σ² of each dimension, [D] each.
    """
    rows = tuple(range(error.dim() - 1))
    squares = (error * torch.exp(-log_std)).square()
    variance = squares.detach().mean(rows).clamp(min=MIN_VARIANCE)
    nll = gaussian_nll(squares / variance, variance.log()) + log_std
    if weighted:
        nll = normalized_weights(torch.exp(log_std)) * nll
    return nll.mean(rows), variance


def weighted_log_score(error: Tensor, variance: Tensor) -> Tensor:
    """−log N(error; 0, σ²) without its constant, weighted, averaged over batch and dimensions.

        E_d E[v (½ e² / σ² + log σ)],   v = σ^0.75 / E σ^0.75

    where v has no gradient. With these weights (Seitzer et al., ICLR 2022) a transition is learned
    even if its error is large and was first explained as noise.

    Args:
        error: e [B, D].
        variance: σ² [B, D].

    Returns:
        a scalar.
    """
    std = variance.sqrt()
    weight = normalized_weights(std**STD_POWER)
    return (weight * (0.5 * error.square() / variance + std.log())).mean()


@in_float32
def projected_log_score(error: Tensor, factor: Tensor) -> Tensor:
    """−log N(wᵀe; 0, wᵀGᵀG w) for random directions w of standardised errors e, averaged.

    `weighted_log_score` scores each dimension alone, so it does not depend on correlations. Here
    the errors have no gradient, so that the mean is learned by that score alone.

    Args:
        error: e [B, D].
        factor: G [B, Z, D].

    Returns:
        a scalar, without its constant.
    """
    std = factor.detach().square().sum(1).clamp(min=MIN_VARIANCE).sqrt()
    directions = torch.randn(error.shape[-1], PROJECTIONS, device=error.device)
    directions = directions / directions.norm(dim=0)
    projected = (error.detach() / std) @ directions
    variance = ((factor / std[:, None]) @ directions).square().sum(1).clamp(min=1e-3)
    return 0.5 * (projected.square() / variance + variance.log()).mean()


def normalized_weights(weights: Tensor) -> Tensor:
    """Weights [..., D] divided by their mean in each dimension, without gradient."""
    weights = weights.detach()
    return weights / weights.mean(tuple(range(weights.dim() - 1)))
