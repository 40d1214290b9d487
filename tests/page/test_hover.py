"""The values that reliability diagrams show on hover; those of curves are in `test_browser`."""

from pathlib import Path

import numpy as np
import pandas as pd

from study.page.figures import draw
from study.page.hover import reliability_bins


def probabilities() -> pd.DataFrame:
    """Forecasts of a calibrated and of an overconfident model, for 40 scenarios at two levels."""
    observed = np.linspace(0.05, 0.95, 40)
    forecasts = {"residual_vae": observed, "full_vae": np.where(observed > 0.5, 1.0, 0.0)}
    tables = [
        pd.DataFrame(
            {
                "environment": "uav", "level": level, "model": model, "seed": 0, "dimension": "all",
                "metric": metric, "step": -1, "scenario": np.arange(40), "value": values,
            }
        )
        for level in ("low", "high")
        for model, forecast in forecasts.items()
        for metric, values in (
            ("forecast_probability", forecast), ("observed_probability", observed)
        )
    ]  # fmt: skip
    return pd.concat(tables, ignore_index=True)


def test_each_point_is_in_its_bin_and_panel() -> None:
    ((name, areas),) = reliability_bins(probabilities())
    assert name == "reliability_uav"
    assert {area.panel for area in areas} == {0, 1}
    for area in areas:
        head, *lines = area.text.splitlines()
        level = ("low", "high")[area.panel]
        assert head == (
            f"UAV, {level} epistemic, forecast probability {area.left:.1f} to {area.right:.1f}"
        )
        for line in lines:
            forecast = float(line.split("forecast ")[1].split(",")[0])
            observed = float(line.split("observed ")[1].split(" [")[0])
            assert area.left - 0.01 <= forecast <= area.right + 0.01
            assert (forecast == observed) == line.startswith("residual VAE")
    lowest = areas[0].text
    assert "full VAE: forecast 0.00, observed 0.27 [" in lowest


def test_the_figure_has_the_areas(tmp_path: Path) -> None:
    probabilities().to_parquet(tmp_path / "scores.parquet")
    drawings, _ = draw(tmp_path)
    svg = drawings["reliability_uav"].svg
    ((_, areas),) = reliability_bins(probabilities())
    assert svg.count('<rect class="step"') == len(areas) > 4
