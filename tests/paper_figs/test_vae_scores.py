"""MMD² of the two VAEs in every universe: the points, their groups and colours."""

from dataclasses import replace
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pandas as pd
import pytest

from paper_figs import specification_curve, vae_scores
from study.config.names import FULL, MLP, RESIDUAL
from study.multiverse.design import RANDOM
from study.multiverse.folder import Multiverse, write
from study.plotting import style
from tests.helpers.multiverse import multiverse
from tests.paper_figs.pictures import pixels_of


def results() -> Multiverse:
    """Two environments. The residual VAE has 0.1, and the full VAE twice that and more."""
    plain = multiverse(random=12)
    residual = plain.cells[plain.cells["model"] == RESIDUAL]
    full = residual.assign(model=FULL, mmd2=0.2 + 0.01 * np.arange(len(residual)))
    pusher = pd.concat([residual, full], ignore_index=True)
    uav = pusher.assign(environment="uav", level="high", mmd2=pusher["mmd2"] / 10)
    second = pusher[pusher["model"] == RESIDUAL].assign(seed=1, mmd2=0.3)
    return replace(plain, cells=pd.concat([pusher, uav, second], ignore_index=True))


def test_the_scores_are_means_over_seeds_with_the_group_of_the_universe() -> None:
    rows = vae_scores.scores(results()).set_index(["universe", "environment", "level"])
    assert rows[RESIDUAL].loc[("study", "pusher", "low")] == pytest.approx((0.1 + 0.3) / 2)
    assert rows[RESIDUAL].loc[("study", "uav", "high")] == pytest.approx(0.01)
    assert rows[FULL].loc[("study", "pusher", "low")] == pytest.approx(0.2)
    groups = rows["group"].groupby("universe").first()
    assert groups["as_written"] == "as_written"
    assert groups["study/target=state"] == "study"
    assert groups["random-03"] == RANDOM


def test_a_universe_without_a_score_is_left_out() -> None:
    found = results()
    failed = (found.cells["universe"] == "study") & (found.cells["model"] == FULL)
    found.cells.loc[failed, "mmd2"] = [np.inf, np.nan]
    assert "study" not in set(vae_scores.scores(found)["universe"])
    only_mlp = replace(found, cells=found.cells[found.cells["model"] == MLP])
    assert vae_scores.draw(only_mlp) is None


def test_points_are_below_the_diagonal_where_the_residual_vae_is_better() -> None:
    with mpl.rc_context(style.context()):
        figure = vae_scores.draw(results())
    assert figure is not None
    assert [axes.get_title(loc="left") for axes in figure.axes] == ["Pusher", "UAV"]
    for axes in figure.axes:
        assert axes.get_xlim() == axes.get_ylim()
        points = [line for line in axes.lines if line.get_linestyle() == "None"]
        xy = np.concatenate([np.asarray(line.get_xydata()) for line in points])
        assert len(xy) == len(results().scored)
        assert (xy[:, 1] <= xy[:, 0] + 1e-12).all()


def test_the_file_has_the_colour_of_each_group(tmp_path: Path) -> None:
    write(results(), tmp_path)
    written = specification_curve.plot(tmp_path)
    picture = tmp_path / "figures" / "vae_scores.png"
    assert picture in written
    for colour in vae_scores.COLOURS:
        assert pixels_of(picture, colour) > 50
