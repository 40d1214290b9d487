"""Generated tables in pages: the marks, and the numbers between them."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from paper_figs import outcome_tables, score_tables
from paper_figs.pages import benchmark_tables, claim_tables, multiverse_tables, study_tables
from paper_figs.pages.marks import rewritten
from paper_figs.scores import read_scores
from study.claims.judge import CLAIMS
from study.claims.paper import BRIER
from study.common.errors import BadInput
from study.config.names import FULL, LABELS, MODELS, RESIDUAL
from study.metrics.tables.table import select
from study.multiverse.choices import each_alone, influence_on
from study.multiverse.design import RANDOM
from study.multiverse.effects import curve
from tests.helpers.multiverse import multiverse
from tests.paper_figs.known_scores import SAMPLES
from tests.paper_figs.pipe_tables import pipe_cells

RESULTS = Path(__file__).parents[2] / "results"
PAGE = (
    "before\n\n<!-- table: one -->\nold\n<!-- end -->\n\nbetween\n\n"
    "<!-- table: two -->\n<!-- end -->\n"
)
NAMES = {text: name for name, text in LABELS.items()}


def test_blocks_are_replaced_and_nothing_else() -> None:
    text = rewritten(PAGE, {"one": lambda: "new\nlines\n", "two": lambda: "2"})
    assert text == (
        "before\n\n<!-- table: one -->\nnew\nlines\n<!-- end -->\n\nbetween\n\n"
        "<!-- table: two -->\n2\n<!-- end -->\n"
    )
    assert rewritten(text, {"one": lambda: "new\nlines", "two": lambda: "2"}) == text


def test_an_unknown_table_is_refused() -> None:
    with pytest.raises(BadInput, match="unknown table 'two'"):
        rewritten(PAGE, {"one": lambda: "", "tow": lambda: ""})


@pytest.mark.parametrize("end", ["", "<!--end-->"])
def test_a_block_without_an_end_is_refused(end: str) -> None:
    tables = {"one": lambda: "", "two": lambda: ""}
    with pytest.raises(BadInput, match="end"):
        rewritten(PAGE.replace("<!-- end -->", end), tables)
    with pytest.raises(BadInput, match="end"):
        rewritten(PAGE.replace("<!-- end -->", end, 1), tables)


def test_skill_is_that_of_the_tables_of_outcomes(outcome_results: Path) -> None:
    study = study_tables.Study(outcome_results)
    blocks = outcome_tables.blocks(read_scores(outcome_results), "uav", "low", SAMPLES)
    for row in blocks[0].rows:
        assert study.skill("uav", "low", row.model) == pytest.approx(row.skill)


def test_the_variance_ratio_is_that_of_the_tables_of_scores(forecast_results: Path) -> None:
    study = study_tables.Study(forecast_results)
    table = score_tables.rows(read_scores(forecast_results), "uav", "low")["variance_ratio"]
    assert study.variance_ratio("uav", "low", FULL) == table[FULL]
    # The horizon of these scores ends before the first step: its last step counts.
    ratio = select(study.scores, "variance_ratio", "uav", "low", FULL, by="dimension and step")
    last = ratio.loc[:, ratio.columns.get_level_values("step") == 6]
    assert table[FULL] == np.median(last)
    one = study.variance_ratio("uav", "low", FULL, "speed")
    assert one == np.median(last["speed"])


@pytest.mark.parametrize(("table", "metric"), [("brier", "brier"), ("mmd", "mmd2")])
def test_scores_are_means_over_seeds(table: str, metric: str) -> None:
    """Compared with the averages that the study stored, which the tables do not read."""
    entries = pipe_cells(study_tables.tables(RESULTS)[table]())
    scores = pd.read_parquet(RESULTS / "paper" / "scores.parquet")
    stored = scores[(scores.step == -1) & (scores.scenario == -1) & (scores.dimension == "all")]
    for (row, head), entry in entries.items():
        environment, level = (NAMES[name] for name in row.split(", "))
        here = stored[stored.environment == environment]
        model = NAMES.get(head, head)
        if model == "climatology":
            here = here[here.metric == "brier_climatology"]
        else:
            here = here[(here.metric == metric) & (here.level == level) & (here.model == model)]
        mean, _, paper = entry.replace("*", "").replace("−", "-").partition(" ")
        assert float(mean) == pytest.approx(here.value.mean(), abs=0.00051), (row, head)
        expected = BRIER.get((environment, level, model)) if metric == "brier" else None
        assert (float(paper.strip("()")) if paper else None) == expected


def test_differences_are_over_the_seeds_that_both_models_have() -> None:
    study, other = (study_tables.Study(RESULTS / "paper") for _ in range(2))
    of_one_model = study.scores["model"] == RESIDUAL
    one_model = study.scores[of_one_model & (study.scores["seed"] == 0)]
    further = one_model.assign(seed=99, value=one_model["value"] + 1)
    vars(other)["scores"] = pd.concat([study.scores, further])
    assert other.mean("mmd2", "uav", "low", RESIDUAL) > study.mean("mmd2", "uav", "low", RESIDUAL)
    assert study_tables.differences(other, "mmd2") == study_tables.differences(study, "mmd2")


def test_the_best_of_the_papers_models_is_bold() -> None:
    entries = pipe_cells(study_tables.tables(RESULTS)["mmd"]())
    for row in {row for row, _ in entries}:
        means = {
            name: float(entry.strip("*"))
            for name, entry in (
                (name, entries[row, name]) for name in (LABELS[model] for model in MODELS)
            )
        }
        bold = [name for (at, name), entry in entries.items() if at == row and "**" in entry]
        assert len(bold) == 1
        assert means[bold[0]] == min(means.values())


def test_verdicts_are_counted(tmp_path: Path) -> None:
    (tmp_path / "paper").mkdir()
    verdicts = [("IV-A", "partly"), ("IV-A", "reproduced"), ("IV-B", "partly"), ("ours", "partly")]
    claims = [{"section": section, "verdict": verdict} for section, verdict in verdicts]
    (tmp_path / "paper" / "claims.json").write_text(json.dumps(claims))
    counts = pipe_cells(claim_tables.tables(tmp_path)["verdicts"]())
    rows = ["**the paper's claims**", "Pusher (section IV-A)", "UAV (section IV-B)"]
    assert [counts[row, "partly"] for row in rows] == ["2", "1", "1"]
    assert [counts[row, "reproduced"] for row in rows] == ["1", "1", "0"]


def test_the_readings_are_those_of_the_multiverse() -> None:
    results = multiverse(random=24)
    first, fifth = CLAIMS[0], CLAIMS[4]  # the fifth has no scores
    claims = [{"id": c.id, "section": c.section, "text": c.text} for c in (first, fifth)]
    table = multiverse_tables.readings(claims, results)
    assert fifth.text not in table
    cells = pipe_cells(table)
    row = f"[{first.text}](../multiverse/figures/specification_{first.id}.png)"
    found = curve(results.effects, first.id).set_index("universe")["verdict"]
    share = (found == "not reproduced").mean()
    assert 0 < share < 1
    assert cells[row, "not reproduced"] == f"{share:.0%}"
    assert cells[row, "study"] == found["study"]
    assert cells[row, "as written"] == found["as_written"]
    assert found["study"] != found["as_written"]
    assert cells[row, "strongest choice"].startswith("forecast (")


def test_without_a_multiverse_the_page_says_so(tmp_path: Path) -> None:
    tables = multiverse_tables.tables(tmp_path)
    assert {table() for table in tables.values()} == {multiverse_tables.NOT_RUN}
    assert tables.keys() == multiverse_tables.tables(RESULTS).keys()


def test_the_changes_are_relative_to_the_base_reading() -> None:
    results = multiverse()
    cells = results.cells
    changed = (cells["universe"] == "study/target=state") & (cells["model"] == RESIDUAL)
    cells.loc[changed, "mmd2"] *= 1.5
    others = [cells.assign(level="high", mmd2=9.0), cells.assign(seed=1)]
    results = replace(results, cells=pd.concat([cells, *others], ignore_index=True))
    table = pipe_cells(multiverse_tables.changes(results, "study"))
    assert table["target: state", "residual VAE, Pusher"] == "1.50"
    assert table["target: state", "probabilistic MLP, Pusher"] == "—"  # the same number
    assert table["target: state", "full VAE, Pusher"] == "failed"  # there is none
    singles = {u.name for u in results.universes if u.base == "study" and u.changed}
    assert len({row for row, _ in table}) == len(singles & set(results.scored))


def test_what_the_choices_explain() -> None:
    results = multiverse(random=24)
    first = CLAIMS[0]
    contrast = "full VAE minus residual VAE"
    effects = results.effects[(results.effects["claim"] == first.id) & results.effects["decisive"]]
    results = replace(results, effects=effects.assign(contrast=contrast))
    found = influence_on(results, first.id, contrast)
    assert found is not None
    table = pipe_cells(multiverse_tables.deciding(results))
    row = "over the full VAE: MMD², Pusher, low epistemic"
    assert {name for name, _ in table} == {row}
    assert table[row, "all choices"] == f"{found.explained:.0%}"
    every, random = (
        each_alone(results, first.id, contrast, group)["forecast"] for group in (None, RANDOM)
    )
    assert table[row, "largest share: one choice"] == f"forecast {every.share:.0%}"
    assert random.is_significant
    assert (
        table[row, "largest share: one choice, random values"] == f"**forecast {random.share:.0%}**"
    )
    added = table[row, "significant shares, given the others"]
    assert added.startswith(f"forecast {found.shares['forecast']:.0%}, ")
    assert "features" not in added  # it adds nothing
    assert multiverse_tables.deciding(multiverse(random=0)).startswith("Too few readings")


def test_the_spread_is_over_the_readings() -> None:
    results = multiverse()
    cells = results.cells[results.cells["model"] == RESIDUAL].reset_index(drop=True)
    cells["mmd2"] = np.arange(len(cells)) / 10
    both = pd.concat([cells, cells.assign(environment="uav", mmd2=1.0)])
    table = pipe_cells(multiverse_tables.spread(replace(results, cells=both)))
    first, median, third = np.quantile(cells["mmd2"], [0.25, 0.5, 0.75])
    entry = f"{median:.3f} ({first:.3f} to {third:.3f})"
    assert table["Pusher, low epistemic", "residual VAE"] == entry
    assert table["UAV, low epistemic", "residual VAE"] == "1.000 (1.000 to 1.000)"
    assert table["UAV, low epistemic", "full VAE"] == "—"
    assert {row for row, _ in table} == {"Pusher, low epistemic", "UAV, low epistemic"}


def test_the_scores_of_the_base_readings() -> None:
    results = multiverse()
    cells = results.cells.copy()
    cells.loc[cells["universe"] == "as_written", "mmd2"] = 0.25
    table = pipe_cells(multiverse_tables.base_readings(replace(results, cells=cells)))
    assert {row for row, _ in table} == {"Pusher, low epistemic"}
    row = {head: entry for (_, head), entry in table.items()}
    for model, (study, as_written) in {
        "residual VAE": ("0.100", "0.250"),
        "full VAE": ("—", "—"),
        "probabilistic MLP": ("0.100", "0.250"),
    }.items():
        assert (row[f"{model}: study"], row[f"{model}: as written"]) == (study, as_written)


def test_a_benchmark_that_was_not_run_says_so(tmp_path: Path) -> None:
    assert benchmark_tables.tables(tmp_path)["scale"]() == benchmark_tables.NOT_MEASURED


def test_the_table_of_a_benchmark(tmp_path: Path) -> None:
    folder = tmp_path / "tests" / "benchmarks" / "results"
    folder.mkdir(parents=True)
    rows = [
        {"size": "quick", "model": "full_vae", "contender": name, "rate": rate, "ratio": ratio}
        for name, rate, ratio in (
            ("ours", 1234.5, [1.0, 1.0, 1.0]),
            ("torch.nn", 600.0, [2.06, 1.9, 2.2]),
        )
    ]
    machine = {"processor": "some processor", "cores": 2, "system": "Linux"}
    record = {"machine": machine, "rows": rows}
    (folder / "training.json").write_text(json.dumps(record))
    text = benchmark_tables.tables(tmp_path)["training"]()
    cells = pipe_cells(text)
    assert cells["quick, full VAE", "transitions / s"] == "1,234"
    assert cells["quick, full VAE", "× torch.nn"] == "2.06 (1.90–2.20)"
    assert text.endswith("some processor, 2 cores, Linux.")


def test_the_table_of_a_cluster() -> None:
    row = {"loss": 0.05, "stages": 10_000, "workers": 256, "lost": 512, "busy": 0.914}
    row |= {"wasted": 0.03, "scheduler_ms": 0.06, "worker_ms": 5.4, "our_share": 0.00015}
    cells = pipe_cells(benchmark_tables.cluster([row]))
    assert cells["5%", "stages on workers"] == "10,000 on 256"
    assert cells["5%", "workers busy"] == "91%"
    assert cells["5%", "both, of the workers' time"] == "0.01%"
