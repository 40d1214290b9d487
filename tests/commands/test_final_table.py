"""The table at the end of a run names what is not finite."""

from pathlib import Path

import pandas as pd
import pytest

from study.commands.final_table import print_table
from study.commands.terminal import console
from study.config.grid import Cell
from study.config.settings import Config
from study.workflow.store import Store
from study.workflow.task import Task

BAD, GOOD = Cell("uav", "low", "full_vae", 0), Cell("uav", "low", "residual_vae", 0)
CURVES = "step,train/loss,validation_score\n1,0.5,\n2,nan,\n3,inf,\n3,,0.4\n"


def output(
    share: float, curves: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> list[str]:
    """The lines that the table of two cells prints; share and curves are those of `BAD`."""
    store = Store(folder / "work")
    records = {}
    tables = []
    for cell in (BAD, GOOD):
        fit = Task("train", cell.name, {"model": cell.model})
        records[cell] = Task("record", cell.name, {}, {"trained": fit})
        store.folder(fit).mkdir(parents=True)
        text = curves if cell == BAD else CURVES.splitlines()[0]
        (store.folder(fit) / "metrics.csv").write_text(text)
        values = {"mmd2": 0.1, "brier": 0.2, "nonfinite": share if cell == BAD else 0.0}
        rows = pd.DataFrame({"metric": list(values), "value": list(values.values())})
        tables.append(rows.assign(dimension="all", step=-1, scenario=-1, **vars(cell)))
    pd.concat(tables).to_parquet(folder / "scores.parquet")
    print_table(console(), Config(), records, store, {}, folder)
    return capsys.readouterr().out.splitlines()


@pytest.mark.parametrize(("share", "text"), [(0.025, "2.5 %"), (1e-6, "less than 0.1 %")])
def test_forecasts_and_losses_that_are_not_finite_are_named(
    share: float, text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = output(share, CURVES, tmp_path, capsys)
    assert f"{BAD.name}: {text} of its forecast values are not finite" in lines
    assert f"train {BAD.name}: 2 of its logged losses are not finite" in lines
    assert not [line for line in lines if GOOD.name in line and "finite" in line]


def test_nothing_is_said_of_finite_forecasts(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = output(0.0, "step,loss\n1,0.5\n", tmp_path, capsys)
    assert not [line for line in lines if "not finite" in line]
    assert [line for line in lines if "plain Brier" in line]
