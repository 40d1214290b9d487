"""The pages: the numbers of the tables, and every failure."""

from dataclasses import replace

import pytest

from study.claims.judge import CLAIMS
from study.multiverse.choices import each_alone, influence_on
from study.multiverse.design import RANDOM
from study.multiverse.effects import curve, join
from study.multiverse.report import pages
from tests.helpers.multiverse import multiverse

BIG = {"random": 24}


def rows_of(page: str, start: str) -> list[list[str]]:
    """The cells of the rows of a page that begin with some text."""
    lines = [line for line in page.splitlines() if line.startswith(start)]
    return [[cell.strip() for cell in line.strip("| ").split(" | ")] for line in lines]


def test_the_row_of_a_claim() -> None:
    results = multiverse(**BIG)
    claim = CLAIMS[0]
    ((_, reproduced, _, not_reproduced, _, effect, decides),) = rows_of(
        pages(results)["README.md"], f"| [{claim.text}]"
    )
    rows = curve(results.effects, claim.id)
    assert reproduced == f"{(rows['verdict'] == 'reproduced').mean():.0%}"
    assert not_reproduced == f"{(rows['verdict'] == 'not reproduced').mean():.0%}"
    assert effect.startswith(f"{rows['effect'].median():+.4f} ({rows['effect'].min():+.4f} to ")
    assert decides.startswith("forecast (")


def test_the_table_of_what_a_value_changes() -> None:
    results = multiverse(**BIG)
    page = pages(results)["choices.md"].split("\n## ")[1]
    found = influence_on(results, CLAIMS[0].id)
    assert found is not None
    term = next(term for term in found.terms if (term.choice, term.value) == ("target", "state"))
    ((_, value, universes, change, rank, share, *alone, study, as_written),) = rows_of(
        page, "| target"
    )
    assert value == "state"
    assert universes == str(term.universes)
    of_effect, of_rank = term.effect, term.rank
    assert change == f"**{of_effect.mean:+.4f} [{of_effect.low:+.4f}, {of_effect.high:+.4f}]**"
    assert rank == f"**{of_rank.mean:+.0%} [{of_rank.low:+.0%}, {of_rank.high:+.0%}]**"
    assert share == f"**{found.shares['target']:.0%}**"
    every, random = (each_alone(results, CLAIMS[0].id, group=g)["target"] for g in (None, RANDOM))
    marked = f"**{random.share:.0%}**" if random.is_significant else f"{random.share:.0%}"
    assert alone == [f"{every.share:.0%}", f"{random.ranks['state']:+.0%}", marked]
    effects = curve(results.effects, CLAIMS[0].id).set_index("universe")["effect"]
    assert study == f"{effects['study/target=state'] - effects['study']:+.4f}"
    # The base reading has the value, and the universe that is changed has the first value.
    assert as_written == f"{effects['as_written'] - effects['as_written/target=change']:+.4f}"


def test_a_change_that_is_excluded_has_a_dash() -> None:
    page = pages(multiverse(**BIG))["choices.md"].split("\n## ")[1]
    assert rows_of(page, "| forecast")[0][-2] == "–"


def test_every_universe_and_every_failure_has_a_row() -> None:
    results = multiverse(**BIG)
    page, failures = pages(results)["README.md"].split("## Failures")
    table = page.split("## Universes")[1].split("\n## ")[0]
    for universe in results.universes:
        assert len(rows_of(table, f"| `{universe.name}` |")) == 1
    (failure,) = results.failures
    assert rows_of(failures, f"| `{failure.universe}`")[0][2] == failure.stage
    assert "it \\| broke" in failures
    assert f"{len(results.universes) - 1} of {len(results.universes)} universes" in page


def test_without_scores_the_pages_say_so() -> None:
    results = multiverse(**BIG)
    empty = replace(
        results,
        effects=join([]),
        cells=results.cells.iloc[:0],
        repeats=results.repeats.iloc[:0],
        failures=[],
    )
    page = pages(empty)["README.md"]
    assert "No universe has scores for a claim." in page
    assert "No stage failed." in page


@pytest.mark.parametrize("count", [0, 1])
def test_too_few_universes_for_a_regression(count: int) -> None:
    results = multiverse(random=0)
    names = results.scored[: count + 1]
    few = replace(results, effects=results.effects[results.effects["universe"].isin(names)])
    assert "Too few universes" in pages(few)["choices.md"]


def test_the_scores_of_further_seeds_stand_below_those_of_the_first() -> None:
    page = pages(multiverse())["README.md"]
    rows = rows_of(page.split("## Variation of training")[1], "| `study`")
    place = ["`study`", "Pusher", "low epistemic"]
    assert rows == [[*place, "0", "0.100", "0.100"], [*place, "1", "0.123", "0.123"]]
    without = replace(multiverse(), repeats=multiverse().repeats.iloc[:0])
    assert "Variation of training" not in pages(without)["README.md"]


def test_a_design_that_is_not_complete_says_so() -> None:
    results = multiverse(**BIG)
    assert "0 of 24" not in pages(results)["README.md"]
    bases = results.effects["universe"].isin(results.design.bases)
    cells = results.cells["universe"].isin(results.design.bases)
    part = replace(results, effects=results.effects[bases], cells=results.cells[cells])
    page = pages(part)["README.md"]
    assert "2 of 2 base readings, 0 of 8 with one change of a base reading and 0 of " in page
    assert "The design is not complete" in page
    assert "Too few universes have scores" in pages(part)["choices.md"]
