"""The table of the posteriors of the fitted VAEs."""

from pathlib import Path
from typing import Any

import pytest

from paper_figs import posteriors
from paper_figs.command import command
from paper_figs.pages import posterior_tables
from study.common.errors import BadInput
from study.common.files import write_json
from study.config.names import FULL, MLP, RESIDUAL
from study.results.summary import FITS, fits_table

FIT = {"environment": "uav", "level": "high", "model": FULL, "seed": 0, "beta": 0.5}


def write(folder: Path, *fits: dict[str, Any]) -> None:
    fits_table(fits).to_parquet(folder / FITS)
    write_json(folder / "study.json", {"settings": {"vae": {"latent_size": 8}}})


def row(text: str, start: str) -> list[str]:
    """The cells of the one row of a Markdown table that starts with `start`."""
    lines = [line for line in text.splitlines() if line.startswith(start)]
    assert len(lines) == 1
    return [cell.strip() for cell in lines[0].strip("|").split("|")]


def test_each_vae_has_a_row_that_says_whether_it_uses_its_latent_variable(tmp_path: Path) -> None:
    used = {"kl": 1.25, "active_units": 3.0, "latent_share": 0.5}
    collapsed = {"kl": 0.0999, "active_units": 0.0, "latent_share": 0.001}
    write(
        tmp_path,
        FIT | collapsed,
        FIT | {"model": MLP, "beta": None, "validation_score": 0.1},
        FIT | used | {"model": RESIDUAL},
        FIT | {"environment": "pusher", "level": "low", "active_units": 2.4} | {"kl": 7.0},
    )
    markdown, tex = posteriors.plot(tmp_path)
    assert [markdown.name, tex.name] == ["posteriors.md", "posteriors.tex"]
    text = markdown.read_text()
    assert text.index("Pusher") < text.index("Residual VAE") < text.index("0.100")
    assert "MLP" not in text
    numbers = ["0", "0.5", "1.250", "3 of 8", "0.50", "used"]
    assert row(text, "| UAV | high epistemic | Residual VAE")[3:] == numbers
    assert row(text, "| UAV | high epistemic | Full VAE")[6:] == ["0 of 8", "0.00", "collapsed"]
    assert row(text, "| Pusher")[6:] == ["2.4 of 8", "—", "used"]
    assert "3 of 8 & 0.50 & used \\\\" in tex.read_text()


def test_the_threshold() -> None:
    assert posteriors.posterior(posteriors.COLLAPSED_BELOW) == "used"
    assert posteriors.posterior(0.999 * posteriors.COLLAPSED_BELOW) == "collapsed"


def test_results_without_fits_have_no_table_and_the_script_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert posteriors.plot(tmp_path) == []
    write(tmp_path, FIT | {"model": MLP})
    assert posteriors.plot(tmp_path) == []
    arguments = [str(tmp_path)]
    code = command(posteriors.plot, "", arguments, missing=posteriors.MISSING)
    assert (code, capsys.readouterr().out) == (0, posteriors.MISSING + "\n")
    with pytest.raises(BadInput, match="no folder"):
        posteriors.plot(tmp_path / "elsewhere")


def test_the_page_shows_the_range_over_seeds_or_says_that_there_are_no_fits(tmp_path: Path) -> None:
    assert posterior_tables.fits(tmp_path) == posterior_tables.NO_FITS
    used = FIT | {"kl": 2.0, "active_units": 1.0, "latent_share": 0.25}
    collapsed = FIT | {"seed": 1, "beta": 80.0, "kl": 0.01, "active_units": 0.0}
    write(tmp_path, used, collapsed | {"latent_share": 0.25})
    numbers = ["0.5 to 80", "0.010 to 2.000", "0 to 1", "0.25", "1 of 2"]
    assert row(posterior_tables.fits(tmp_path), "| UAV, high epistemic, full VAE")[1:] == numbers


def test_the_page_compares_the_ranges_of_beta_on_the_fork() -> None:
    change = "tune.beta_low=100"
    mlp = {"beta": None, "mmd2": 0.04}
    used = {"beta": 0.5, "mmd2": 0.001, "kl": 1.3, "latent_share": 0.98}
    collapsed = {"beta": 150.0, "mmd2": 0.05, "kl": 0.0, "latent_share": 0.0}
    cell = "fork/low/{}/seed-0"
    record = {
        "settings": {"ablations": [change]},
        "scores": {
            change: {cell.format(FULL): collapsed, cell.format(MLP): mlp},
            "as it is": {cell.format(FULL): used, cell.format(MLP): mlp},
        },
    }
    table = posterior_tables.fork(record)
    assert row(table, "| Full VAE | 0.5")[2:] == ["1.300", "0.98", "used", "0.0010"]
    assert row(table, "| Full VAE | 150")[2:] == ["0.000", "0.00", "collapsed", "0.0500"]
    assert row(table, "| Probabilistic MLP")[1:] == ["—", "—", "—", "—", "0.0400"]
