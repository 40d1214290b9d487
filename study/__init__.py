"""A reproducibility study: forecasting aleatoric and epistemic uncertainty over long horizons."""

__version__ = "0.1.0"
