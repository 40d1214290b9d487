"""Variance ratios, heat maps and calibration are drawn from scores alone, whatever is there."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib as mpl
import matplotlib.image
import numpy as np
import pandas as pd
import pytest
from matplotlib.colors import to_rgb

from paper_figs import calibration, mmd_by_dimension, variance_ratio
from paper_figs.scores import command
from study.common.errors import BadInput
from study.config.names import FULL, ORACLE, RESIDUAL
from study.metrics.tables.table import by_dimension_and_step
from study.metrics.tables.trajectory_scores import trajectory_rows
from study.metrics.variance import variance_ratio as ratio_of
from study.plotting import style

NAMES = ("heading", "speed", "battery")
MMD2 = {RESIDUAL: (0.02, 0.05, 0.3), FULL: (0.3, 0.1, 0.6), ORACLE: (0.0, 0.0, -0.001)}
SPREAD = {RESIDUAL: 1.2, FULL: 0.4, ORACLE: 1.0}
SCRIPTS = {
    "variance": variance_ratio.plot,
    "mmd_by_dimension": mmd_by_dimension.plot,
    "calibration": calibration.plot,
}


def cell(model: str, steps: int = 6) -> pd.DataFrame:
    """Rows of forecasts of known width, with constant MMD² in each dimension."""
    generator = np.random.default_rng(sum(map(ord, model)))
    observed = generator.normal(size=(20, 12, steps, 3)).astype(np.float32)
    forecast = SPREAD.get(model, 2.0) * generator.normal(size=observed.shape).astype(np.float32)
    member = generator.integers(0, 3, forecast.shape[:2]) if model == RESIDUAL else None
    if member is not None:
        forecast += 0.8 * (member - 1)[:, :, None, None]
    names, unit = np.array([*NAMES, "all"], object), np.ones(3)
    mmd2 = np.tile(MMD2.get(model, (0.1, 0.1, 0.1)), (steps, 1))
    return pd.concat(
        [
            trajectory_rows(forecast, observed, unit, NAMES, member),
            by_dimension_and_step("variance_ratio", ratio_of(forecast, observed, unit), names),
            by_dimension_and_step("mmd2", mmd2, names),
        ]
    )


def write(folder: Path, cells: list[tuple[str, str, str]]) -> Path:
    table = pd.concat(
        [
            cell(model).assign(environment=environment, level=level, model=model, seed=seed)
            for environment, level, model in cells
            for seed in (0, 1)
        ],
        ignore_index=True,
    )
    table.to_parquet(folder / "scores.parquet")
    return folder


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Both levels, of which a cell of one failed, and the oracle scored once."""
    cells = [("uav", "low", RESIDUAL), ("uav", "high", RESIDUAL), ("uav", "low", FULL)]
    return write(tmp_path_factory.mktemp("results"), [*cells, ("uav", "low", ORACLE)])


@pytest.fixture(scope="module")
def drawn(results: Path) -> dict[str, list[Path]]:
    return {name: draw(results) for name, draw in SCRIPTS.items()}


@pytest.fixture
def another(tmp_path: Path) -> Path:
    """An environment and a model that the paper does not have, at one level, no reference."""
    return write(tmp_path, [("toy", "low", "normalising_flow")])


def near(path: Path, colour: Any, within: float = 0.01) -> int:
    """How many pixels of a picture have a colour."""
    picture = matplotlib.image.imread(path)[..., :3]
    return int((np.abs(picture - np.array(colour[:3])).max(-1) < within).sum())


@pytest.mark.parametrize("name", SCRIPTS)
def test_files_are_one_column_wide(results: Path, drawn: dict[str, list[Path]], name: str) -> None:
    png, pdf = drawn[name]
    assert png == results / "figures" / f"{name}_uav.png"
    assert pdf == png.with_suffix(".pdf")
    assert matplotlib.image.imread(png).shape[1] == pytest.approx(300 * style.COLUMN_WIDTH, abs=2)
    assert b"/Type3" not in pdf.read_bytes()


@pytest.mark.parametrize("name", ["variance", "calibration"])
def test_every_model_has_its_colour(drawn: dict[str, list[Path]], name: str) -> None:
    for model in MMD2:
        assert near(drawn[name][0], to_rgb(style.COLOURS[model])) > 200, model


def test_maps_show_each_value_in_its_colour(drawn: dict[str, list[Path]]) -> None:
    colours = mpl.colormaps[mmd_by_dimension.COLOURS]
    height = 300 * mmd_by_dimension.ROW
    for model, values in MMD2.items():
        for value in values:
            colour = colours(np.sqrt(max(value, 0) / 0.6))
            # A row is at least as wide as an inch, at 300 dots an inch.
            assert near(drawn["mmd_by_dimension"][0], colour, 0.03) > 0.5 * height * 300, model


@pytest.mark.parametrize("name", SCRIPTS)
def test_an_environment_and_a_model_of_ones_own(another: Path, name: str) -> None:
    paths = SCRIPTS[name](another)
    assert [path.name for path in paths] == [f"{name}_toy.png", f"{name}_toy.pdf"]


def test_maps_are_the_same_each_time(another: Path) -> None:
    first = [path.read_bytes() for path in mmd_by_dimension.plot(another)]
    assert [path.read_bytes() for path in mmd_by_dimension.plot(another)] == first


def without(folder: Path, *starts: str) -> None:
    table = pd.read_parquet(folder / "scores.parquet")
    table[~table["metric"].str.startswith(starts)].to_parquet(folder / "scores.parquet")


def test_results_without_coverage_leave_no_figure_of_calibration(another: Path) -> None:
    without(another, "coverage_", "pit_")
    assert calibration.plot(another) == []
    assert not (another / "figures").exists()


def test_results_without_the_aleatoric_ratio_show_the_total(another: Path) -> None:
    with_both = variance_ratio.plot(another)[0]
    colour = to_rgb(style.colours(["normalising_flow"])["normalising_flow"])
    expected = near(with_both, colour)
    assert expected > 200
    without(another, "aleatoric_ratio")
    # Without an ensemble the two are equal: the same line.
    assert near(variance_ratio.plot(another)[0], colour) == pytest.approx(expected, rel=0.1)


def test_infinite_scores_do_not_break_a_figure(another: Path) -> None:
    table = pd.read_parquet(another / "scores.parquet")
    ratio = table["metric"].isin(["aleatoric_ratio", "variance_ratio"])
    table.loc[ratio & (table["step"] > 3), "value"] = np.inf
    table.loc[ratio & (table["step"] == 1), "value"] = np.nan
    table.to_parquet(another / "scores.parquet")
    assert all(path.stat().st_size > 1000 for path in variance_ratio.plot(another))


@pytest.mark.parametrize("draw", SCRIPTS.values())
def test_nothing_to_draw_from_is_one_clear_line(
    tmp_path: Path, draw: Callable[[Path], list[Path]], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(BadInput, match="holds no scores"):
        draw(tmp_path)
    assert command(draw, "", [str(tmp_path)]) == 2
    assert capsys.readouterr().err.count("\n") == 1
