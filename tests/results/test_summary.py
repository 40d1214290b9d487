"""The table of the fitted models, from the files of the stages."""

from pathlib import Path

import pandas as pd

from study.common.files import read_json
from study.config.names import FULL
from study.results import checksums
from study.results.summary import DIAGNOSTICS, FITS


def test_each_fitted_model_has_a_row_with_the_numbers_of_its_fit(copied: Path) -> None:
    table = pd.read_parquet(copied / FITS)
    assert sorted(table["model"]) == ["drift", FULL]
    assert (table[["environment", "level", "seed"]] == ["cart", "low", 0]).all(axis=None)
    fits = [read_json(path) for path in copied.glob("work/train/*/fit.json")]
    (vae,) = [fit for fit in fits if "kl" in fit]
    row = table[table["model"] == FULL].iloc[0]
    assert {name: row[name] for name in DIAGNOSTICS} == {name: vae[name] for name in DIAGNOSTICS}
    assert table[table["model"] == "drift"][["beta", "kl", "latent_share"]].isna().all(axis=None)
    assert FITS in checksums.read(copied)
    assert (copied / "tables" / "posteriors.md").is_file()
