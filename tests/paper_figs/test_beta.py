"""The figure of the searches for β."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from paper_figs import beta
from study.common.errors import BadInput
from study.config.names import FULL, RESIDUAL
from study.plotting import style
from tests.paper_figs.pictures import pixels_of


@pytest.fixture
def trials() -> pd.DataFrame:
    betas = np.geomspace(0.1, 30, 6)
    return pd.concat(
        pd.DataFrame(
            {
                "environment": environment,
                "level": level,
                "model": model,
                "seed": 0,
                "number": range(6),
                "state": ["complete"] * 5 + ["pruned"],
                "beta": betas,
                "value": np.log(betas) ** 2 / 10 + 0.1,
                "chosen": np.arange(6) == 2,
            }
        )
        for environment in ("pusher", "uav")
        for level in ("low", "high")
        for model in (RESIDUAL, FULL)
    )


def test_the_searches_of_both_models_are_visible(trials: pd.DataFrame, tmp_path: Path) -> None:
    trials[trials.model == RESIDUAL].to_parquet(tmp_path / "trials.parquet")
    assert pixels_of(beta.plot(tmp_path)[0], style.COLOURS[FULL], 0.12) == 0
    trials.to_parquet(tmp_path / "trials.parquet")
    picture, _ = beta.plot(tmp_path)
    assert pixels_of(picture, style.COLOURS[RESIDUAL], 0.12) > 300
    assert pixels_of(picture, style.COLOURS[FULL], 0.12) > 300


def test_no_trials_and_no_table_of_trials(trials: pd.DataFrame, tmp_path: Path) -> None:
    trials.iloc[:0].to_parquet(tmp_path / "trials.parquet")
    assert beta.plot(tmp_path) == []
    with pytest.raises(BadInput, match=r"no trials\.parquet"):
        beta.plot(tmp_path / "elsewhere")
