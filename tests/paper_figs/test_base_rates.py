"""The histogram of true probabilities."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from paper_figs import base_rates
from tests.paper_figs.pictures import pixels_of


def test_bars_are_proportional_to_numbers_of_scenarios(tmp_path: Path) -> None:
    probability = np.repeat([0.0, 0.3, 0.5, 0.95], [5, 20, 10, 5])
    rows = pd.DataFrame(
        {
            "environment": "uav",
            "level": "low",
            "model": "oracle",
            "seed": 0,
            "metric": "observed_probability",
            "dimension": "all",
            "step": -1,
            "scenario": range(40),
            "value": probability,
        }
    )
    pd.concat([rows, rows.assign(model="full_vae")]).to_parquet(tmp_path / "scores.parquet")
    picture, _ = base_rates.plot(tmp_path)
    middle, ends = (pixels_of(picture, c, 0.12) for c in (base_rates.MIDDLE, base_rates.ENDS))
    assert middle / ends == pytest.approx(30 / 10, rel=0.35)
