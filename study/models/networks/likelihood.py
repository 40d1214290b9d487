"""The Gaussian likelihoods that the models are fitted by."""

import math

import torch
from torch import Tensor

# In the logarithmic score a transition counts by its standard deviation to this power.
BY_WIDTH = 0.75
# Squared error below which a dimension counts as learned: keeps the logarithm finite.
_LEAST = 1e-10


def negative_log_likelihood(squared_error: Tensor) -> Tensor:
    """−log N(s; ŝ, σ²) of one dimension, averaged over a batch, at the σ that fits it best.

        min_σ ½ E(s − ŝ)² / σ² + log σ + ½ log 2π = ½ (log E(s − ŝ)² + 1 + log 2π)

    (Rybkin, Daniilidis and Levine, ICML 2021: the optimal σ-VAE). Of a logarithm the derivative is
    relative, so dimensions whose noise differs by orders of magnitude weigh alike from the first
    step on, where a learned σ would have to get there first.

    Args:
        squared_error: E(s − ŝ)², the mean over the batch, [...].

    Returns:
        [...]
    """
    return 0.5 * (squared_error.clamp(min=_LEAST).log() + 1 + math.log(2 * math.pi))


def weighted_negative_log_likelihood(error: Tensor, log_width: Tensor) -> tuple[Tensor, Tensor]:
    """The same with a width that varies, weighted so that wide steps are learned as well.

        E[e^w (½ (s − ŝ)² / (σ² e^2w) + w + log σ + ½ log 2π)] / E e^w,   σ² = E[(s − ŝ)² / e^2w]

    where no derivative goes through the weights or σ. (Seitzer et al., ICLR 2022: the β-NLL, with
    its β, which is not that of equation 12, at ½. Without weights a step whose error was first
    taken for noise hardly counts, and is never learned.) With w = 0 it is
    `negative_log_likelihood`, and so is its derivative by the error.

    Args:
        error: s − ŝ [B, T, D].
        log_width: w [B, T, D].

    Returns:
        for each dimension the likelihood and σ², [D] each.
    """
    squares = (error * torch.exp(-log_width)).square()
    variance = squares.detach().mean((0, 1)).clamp(min=_LEAST)
    each = 0.5 * (squares / variance + variance.log() + math.log(2 * math.pi)) + log_width
    return (by_width(log_width) * each).mean((0, 1)), variance


def logarithmic_score(error: Tensor, variance: Tensor) -> Tensor:
    """−log N(error; 0, variance) of each dimension, weighted, averaged over all.

        E_d E[w (½ e² / σ² + log σ)],   w = σ^0.75 / E σ^0.75 without a derivative

    The weights (Seitzer et al., ICLR 2022) let transitions whose error is large, and was first
    taken for noise, be learned all the same. So does the logarithm of the mean's squared error,
    beside which this stands: to it nothing is noise.

    Args:
        error: [B, D].
        variance: σ² [B, D].
    """
    deviation = variance.sqrt()
    weight = relative(deviation**BY_WIDTH)
    return (weight * (0.5 * error.square() / variance + deviation.log())).mean()


def by_width(log_width: Tensor) -> Tensor:
    """Weights e^w / E e^w in each dimension, [B, T, D] from w [B, T, D], without a derivative."""
    return relative(torch.exp(log_width))


def relative(weight: Tensor) -> Tensor:
    """Weights [..., D] over their mean in each dimension, without a derivative."""
    weight = weight.detach()
    return weight / weight.mean(tuple(range(weight.dim() - 1)))
