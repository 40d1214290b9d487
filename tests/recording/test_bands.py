"""Quantile bands, and the axes of their plots."""

import numpy as np
import pytest

from study.recording import bands
from tests.helpers import recordings


def test_where_no_value_is_finite_the_quantiles_are_nan() -> None:
    states = recordings.examples(recordings.Puck(), 1)[0].observed.copy()
    states[:, 10:] = np.nan
    states[0, 5] = np.inf
    assert np.isnan(bands.quantiles(states)[:, 10:]).all()
    assert np.isfinite(bands.quantiles(states)[:, :10]).all()


def test_an_axis_is_fixed_only_where_the_viewer_would_choose_another() -> None:
    observed = np.linspace(0.0, 1.0, 5)[:, None] * np.ones(9)
    assert bands.axis_range(observed, observed + 0.5) is None
    diverged = bands.axis_range(observed, observed * 100)
    assert diverged == pytest.approx((-0.1, 2.1))
    flat = bands.axis_range(np.full((5, 9), 3.0), np.full((5, 9), 3.0 + 1e-9))
    assert flat is not None
    assert flat[0] < 3.0 < flat[1]
