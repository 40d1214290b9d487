"""Which universes of a design another multiverse has, and how their results are merged."""

import copy
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from study.claims.judge import CLAIMS
from study.commands.settings import read_config, read_part
from study.common.errors import BadInput, StudyError
from study.common.files import read_json, write_json
from study.common.provenance import versions
from study.config.grid import Cell, cells
from study.multiverse import folder
from study.multiverse.design import config_of_universe
from study.multiverse.effects import COLUMNS
from study.multiverse.folder import REUSED, Failure, Multiverse
from study.multiverse.merge import merge
from study.multiverse.read import PART, design_from
from study.multiverse.report import pages
from study.multiverse.universes import universes
from study.results import checksums, multiverse
from study.results.folder import settings_of
from study.results.reuse import add, find
from tests.helpers.small_multiverse import DESIGN, written_design

OLD = ["study", "as_written", "study/loss=plain", "as_written/loss=plain"]
WIDER = copy.deepcopy(DESIGN["choices"]["loss"])
WIDER["values"]["wide"] = {"mlp.hidden_size": 6}


class Planned:
    """A design, with results of all universes in which every score is `score`."""

    def __init__(
        self,
        root: Path,
        *,
        seeds: Sequence[int] = (0,),
        further: Sequence[int] = (1,),
        score: float = 0.1,
        texts: Mapping[str, str] | None = None,
        **choices: Mapping[str, Any],
    ) -> None:
        path = str(written_design(root, further, **choices))
        texts = {"grid.seeds": str(list(seeds)), **(texts or {})}
        self.config = read_config(path, texts, part=PART)
        self.design = design_from(read_part(path, PART))
        self.universes = universes(self.design)
        self.configs = {
            u.name: config_of_universe(self.config, self.design, u) for u in self.universes
        }
        every = [(name, cell) for name, config in self.configs.items() for cell in cells(config)]
        judged = [(name, cell) for name, cell in every if cell.seed in seeds]
        repeats = [pair for pair in every if pair not in judged]
        effects = pd.DataFrame(
            [_effect(name, score) for name in self.configs], columns=list(COLUMNS)
        )
        facts = {"settings": settings_of(self.config), "versions": versions()}
        self.results = Multiverse(
            self.design,
            self.universes,
            effects.astype(COLUMNS),
            _table(judged, score),
            _table(repeats, score),
            [],
            facts,
        )

    def without(self, *names: str, failures: Sequence[Failure] = ()) -> Multiverse:
        """The results without some universes."""
        old = self.results

        def rest(table: pd.DataFrame) -> pd.DataFrame:
            return table[~table["universe"].isin(names)].reset_index(drop=True)

        return replace(
            old,
            effects=rest(old.effects),
            cells=rest(old.cells),
            repeats=rest(old.repeats),
            failures=list(failures),
        )


def _effect(universe: str, score: float) -> dict[str, Any]:
    row: dict[str, Any] = {"universe": universe, "claim": CLAIMS[0].id, "verdict": "partly"}
    row |= {"contrast": "a", "decisive": True, "low": 0.0, "high": 1.0, "status": "undecided"}
    return row | {"effect": score, "margin": 0.0, "scenarios": 4, "seeds": 1}


def _table(pairs: Sequence[tuple[str, Cell]], score: float) -> pd.DataFrame:
    rows = [
        {"universe": name, **vars(cell), **dict.fromkeys(multiverse.METRICS, score)}
        for name, cell in pairs
    ]
    return multiverse._table(rows)


def written(results: Multiverse, out: Path) -> Path:
    out.mkdir()
    folder.write(results, out)
    checksums.seal(out, multiverse.present(out))
    return out


def found(source: Multiverse, planned: Planned, out: Path) -> Mapping[str, str]:
    path = written(source, out)
    return find(path, planned.config, planned.design, planned.configs).names


def test_universes_with_the_same_settings_are_found(tmp_path: Path) -> None:
    old, new = Planned(tmp_path), Planned(tmp_path, loss=WIDER)
    assert found(old.results, new, tmp_path / "a") == {name: name for name in OLD}
    renamed = copy.deepcopy(DESIGN["choices"]["loss"])
    renamed["values"] = {"nothing": {"mlp.loss": "beta_nll"}, "other": {"mlp.loss": "nll"}}
    other = found(old.results, Planned(tmp_path, loss=renamed), tmp_path / "b")
    assert other["study/loss=other"] == "study/loss=plain"
    changed = copy.deepcopy(DESIGN["choices"]["loss"])
    changed["values"]["plain"]["mlp.layers"] = 2
    same = found(old.results, Planned(tmp_path, loss=changed), tmp_path / "c")
    assert list(same) == ["study", "as_written"]


def test_seeds_that_are_judged_are_not_further_seeds(tmp_path: Path) -> None:
    one, both = Planned(tmp_path), Planned(tmp_path, seeds=[0, 1], further=[])
    with pytest.raises(BadInput, match="'study' differs in its cells or seeds"):
        found(one.results, both, tmp_path / "one")
    with pytest.raises(BadInput, match="'study' differs in its cells or seeds"):
        found(both.results, one, tmp_path / "both")
    reverse = Planned(tmp_path, seeds=[1], further=[0])
    with pytest.raises(BadInput, match="'study' differs in its cells or seeds"):
        found(one.results, reverse, tmp_path / "reverse")


def test_universes_without_all_cells_are_not_found(tmp_path: Path) -> None:
    old, new = Planned(tmp_path), Planned(tmp_path, loss=WIDER)
    cell = "pusher/low/full_vae/seed-0"
    failures = [Failure("study", cell, f"train {cell}", "it broke")]
    source = old.without("as_written", failures=failures)
    first = source.cells["universe"] == "study/loss=plain"
    source = replace(source, cells=source.cells.drop(source.cells[first].index[0]))
    assert list(found(source, new, tmp_path / "a")) == ["as_written/loss=plain"]


def test_what_cannot_be_compared_is_refused(tmp_path: Path) -> None:
    old = Planned(tmp_path)
    path = written(old.results, tmp_path / "old")

    def message(path: Path, planned: Planned) -> str:
        with pytest.raises((BadInput, StudyError)) as error:
            find(path, planned.config, planned.design, planned.configs)
        return str(error.value)

    other = Planned(tmp_path, texts={"train.steps": "3", "mlp.layers": "2"})
    none = f"--reuse: no universe of {path} has the settings and cells of one in this design"
    assert message(path, other) == f"{none}; 'study' differs in mlp.layers, train.steps"
    plugin = replace(old.config, plugins=("tests.helpers.models",))
    with pytest.raises(BadInput, match=r"--reuse: the code of plugins .*tests\.helpers\.models"):
        find(path, plugin, old.design, old.configs)
    nothing = tmp_path / "nothing"
    assert message(nothing, old).startswith(f"--reuse: there is no multiverse in {nothing}: run")
    (tmp_path / "study.json").write_text("{}")
    assert message(tmp_path, old) == f"--reuse: {tmp_path} has a study, not a multiverse"
    claims = old.results.effects.assign(claim="of another version")
    version = written(replace(old.results, effects=claims), tmp_path / "version")
    assert message(version, old) == f"--reuse: {version} is of a version with other claims"
    (path / folder.EFFECTS).write_bytes(b"damaged")
    assert message(path, old).startswith("--reuse: ")
    assert "damaged" in message(path, old)


@pytest.mark.parametrize(
    "facts",
    [
        {REUSED: 5},
        {REUSED: {"study": 5}},
        {"universes": [{"name": "study", "base": None, "changed": None, "values": {}}]},
        {"failures": [{"universe": ["a"], "cell": "", "stage": "", "error": ""}]},
    ],
)
def test_damaged_facts_have_one_line(facts: dict[str, Any], tmp_path: Path) -> None:
    path = written(Planned(tmp_path).results, tmp_path / "old")
    write_json(path / folder.FACTS, read_json(path / folder.FACTS) | facts)
    with pytest.raises(StudyError, match="is damaged"):
        folder.read(path)


def test_the_results_are_added(tmp_path: Path) -> None:
    """Those of other universes, under their names here, with the versions that differ."""
    old, new = Planned(tmp_path, score=0.5), Planned(tmp_path, loss=WIDER)
    facts = {**old.results.facts, "versions": {**versions(), "python": "3.1"}}
    path = written(replace(old.results, facts=facts), tmp_path / "old")
    reusable = find(path, new.config, new.design, new.configs)
    merged = add(new.without(*OLD), reusable)
    assert set(merged.scored) == set(new.configs)
    assert merged.facts[REUSED] == {
        name: {"python": "3.1"} for name in merged.values if name in OLD
    }
    means = merged.cells.groupby("universe")["mmd2"].mean()
    assert (means[OLD] == 0.5).all()
    assert means.drop(OLD).eq(0.1).all()
    assert merged.cells.dtypes.equals(new.results.cells.dtypes)
    assert set(merged.repeats["universe"]) == {"study", "as_written"}
    text = "4 universes were taken from another multiverse, which was run with python 3.1."
    assert text in pages(merged)["README.md"]
    # Taken again from the merged results: the versions stay.
    again = find(written(merged, tmp_path / "m"), new.config, new.design, new.configs)
    assert set(again.names) == set(new.configs)
    twice = add(new.without(*new.configs), again)
    assert twice.facts[REUSED]["study"] == {"python": "3.1"}
    assert twice.facts[REUSED]["study/loss=wide"] == {}
    assert twice.cells.dtypes.equals(new.results.cells.dtypes)
    # What has run here is kept.
    assert REUSED not in add(new.results, again).facts


def test_a_universe_that_failed_here_is_taken(tmp_path: Path) -> None:
    old, new = Planned(tmp_path, score=0.5), Planned(tmp_path)
    reusable = find(written(old.results, tmp_path / "old"), new.config, new.design, new.configs)
    first = new.results.cells["universe"] == "study"
    cell = "pusher/low/full_vae/seed-0"
    failed = replace(
        new.results,
        cells=new.results.cells.drop(new.results.cells[first].index[0]),
        failures=[Failure("study", cell, f"train {cell}", "it broke")],
    )
    merged = add(failed, reusable)
    assert list(merged.facts[REUSED]) == ["study"]
    assert not merged.failures
    assert (merged.cells.loc[merged.cells["universe"] == "study", "mmd2"] == 0.5).all()


def test_joined_parts_keep_what_was_reused(tmp_path: Path) -> None:
    planned = Planned(tmp_path)
    own = planned.without("study", "study/loss=plain")
    other = planned.without("as_written", "as_written/loss=plain")
    other = replace(other, facts={**other.facts, REUSED: {"study": {"torch": "1"}}})
    for parts in ([own, other], [other, own]):
        assert merge(parts).facts[REUSED] == {"study": {"torch": "1"}}
    assert REUSED not in merge([own, own]).facts
