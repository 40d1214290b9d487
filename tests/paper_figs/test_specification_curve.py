"""Specification curves: their files, the colours of the verdicts, and the order of universes."""

from dataclasses import replace
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.text import Text

from paper_figs import specification_curve
from study.claims.claim import Rule
from study.claims.judge import CLAIMS
from study.multiverse.effects import curve
from study.multiverse.folder import EFFECTS, read, write
from study.plotting import style
from study.plotting.png import WIDTH
from tests.helpers.multiverse import multiverse
from tests.paper_figs.pictures import pixels_of, size_of

FIRST = CLAIMS[0]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("multiverse")
    results = multiverse(random=24)
    few = results.effects["claim"].isin([FIRST.id, CLAIMS[1].id])
    write(results, folder)
    results.effects[few].to_parquet(folder / EFFECTS)
    return folder


@pytest.fixture(scope="module")
def figures(folder: Path) -> list[Path]:
    return specification_curve.plot(folder)


def test_a_figure_for_each_claim_with_effects_and_one_of_all(figures: list[Path]) -> None:
    pictures = ["verdicts.png", *(f"specification_{claim.id}.png" for claim in CLAIMS[:2])]
    assert [path.name for path in figures] == [*pictures, "curves.pdf"]
    assert figures[-1].read_bytes().count(b"/Type /Page ") == 3
    assert size_of(figures[1])[0] == pytest.approx(300 * WIDTH, abs=2)


def test_the_colours_of_the_verdicts_that_occur(folder: Path, figures: list[Path]) -> None:
    present = set(curve(read(folder).effects, FIRST.id)["verdict"])
    assert {"reproduced", "not reproduced"} <= present
    for verdict in present:
        assert pixels_of(figures[1], specification_curve.COLOURS[verdict]) > 300
        assert pixels_of(figures[0], specification_curve.COLOURS[verdict]) > 2000


def test_dots_ascend_and_stand_above_their_values(folder: Path) -> None:
    results = read(folder)
    rows = curve(results.effects, FIRST.id)
    with mpl.rc_context(style.context()):
        above, below = specification_curve._specification(results, FIRST).axes
    dots = np.concatenate(
        [
            np.column_stack(line.get_data())
            for line in above.lines
            if line.get_marker() == "o" and line.get_color() != specification_curve.OTHER
        ]
    )
    (grey,) = [line for line in above.lines if line.get_color() == specification_curve.OTHER]
    np.testing.assert_allclose(np.sort(grey.get_ydata()), np.sort(rows["effect"]) + 1)
    ordered = dots[np.argsort(dots[:, 0])]
    np.testing.assert_array_equal(ordered[:, 0], np.arange(len(rows)))
    np.testing.assert_array_equal(ordered[:, 1], rows["effect"])
    ticks = dict(
        zip([t.get_text() for t in below.get_yticklabels()], below.get_yticks(), strict=True)
    )
    coloured = [line for line in below.lines if line.get_color() != specification_curve.EMPTY]
    dots = np.concatenate(
        [np.column_stack(line.get_data()) for line in coloured if line.get_marker() == "o"]
    )
    with_mean = set(dots[dots[:, 1] == ticks["mean"], 0].astype(int))
    expected = [results.values[name]["forecast"] == "mean" for name in rows["universe"]]
    assert with_mean == set(np.flatnonzero(expected))


def test_a_universe_that_diverges_hides_no_other(folder: Path) -> None:
    """Effects about as large as the smallest effect of interest stay apart from zero."""
    results = read(folder)
    claim = results.effects["claim"] == FIRST.id
    results.effects.loc[results.effects[claim]["effect"].idxmax(), "effect"] = 1000.0
    with mpl.rc_context(style.context()):
        above, _ = specification_curve._specification(results, FIRST).axes
    to_axes = above.transScale + above.transLimits
    zero, smallest, largest = to_axes.transform([(0, 0), (0, FIRST.smallest_effect), (0, 1000)])[
        :, 1
    ]
    assert smallest - zero > 0.02
    assert 0.8 < largest < 1
    ticks = above.get_yticks()
    assert {-0.01, 0.0, 0.01, 1000.0} <= set(ticks)
    assert not set(ticks) & {-0.001, 0.001}  # they would overlap that of zero


def test_the_title_fits(folder: Path) -> None:
    results = read(folder)
    longest = max(CLAIMS, key=lambda claim: len(claim.text))
    first = results.effects["claim"] == FIRST.id
    renamed = replace(results, effects=results.effects[first].assign(claim=longest.id))
    with mpl.rc_context(style.context()):
        figure = specification_curve._specification(renamed, longest)
        figure.draw_without_rendering()
    (title,) = [
        text
        for text in figure.axes[0].findobj(Text)
        if text.get_text().startswith(longest.text[:20])
    ]
    assert title.get_window_extent().x1 <= figure.bbox.x1


def test_infinite_intervals_and_effects_are_drawn(folder: Path, tmp_path: Path) -> None:
    results = read(folder)
    results.effects.loc[results.effects["decisive"], "high"] = np.inf
    results.effects.loc[results.effects.index[0], "effect"] = np.inf
    write(results, tmp_path)
    assert len(specification_curve.plot(tmp_path)) == 4


def test_the_folder_of_a_study_gets_no_figure(results: Path) -> None:
    assert specification_curve.plot(results) == []


@pytest.mark.parametrize(
    ("rule", "expected"),
    [(Rule.ABOVE, [0.002]), (Rule.NOT_BELOW, [-0.002]), (Rule.EQUAL, [-0.007, 0.007])],
)
def test_the_thresholds_are_those_of_the_rule(
    rule: Rule, expected: list[float], folder: Path
) -> None:
    results = read(folder)
    rows = curve(results.effects.assign(margin=0.007), FIRST.id)
    assert FIRST.smallest_effect == 0.002
    found = specification_curve._thresholds(rows, replace(FIRST, rule=rule))
    assert sorted({float(value) for line in found for value in line}) == expected


def test_small_effects_have_ticks_too() -> None:
    assert specification_curve._ticks(-0.006, 0.008, 0.002) == [0.0, -0.002, 0.002]
    assert specification_curve._ticks(-0.02, 0.2, 0.002) == [0.0, -0.01, 0.01, 0.1]
