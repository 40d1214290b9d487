"""The Gaussian likelihood that the ensemble and the VAEs are fitted by."""

import math

from torch import Tensor

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
