"""The files of a multiverse are read as they were written, or refused in one line."""

import json
from pathlib import Path

import pandas as pd
import pytest

from study.common.errors import BadInput, StudyError
from study.multiverse.folder import CELLS, EFFECTS, FACTS, FILES, REPEATS, read, write
from study.multiverse.report import pages
from tests.helpers.multiverse import multiverse


@pytest.fixture
def written(tmp_path: Path) -> Path:
    write(multiverse(), tmp_path)
    return tmp_path


def test_what_was_written_is_read(written: Path) -> None:
    expected, found = multiverse(), read(written)
    assert found.design == expected.design
    assert list(found.design.bases) == list(expected.design.bases)
    assert [list(choice.values) for choice in found.design.choices] == [
        list(choice.values) for choice in expected.design.choices
    ]
    assert list(found.universes) == list(expected.universes)
    assert list(found.failures) == list(expected.failures)
    assert [list(u.values.items()) for u in found.universes] == [
        list(u.values.items()) for u in expected.universes
    ]
    assert found.facts == expected.facts
    assert found.scored == expected.scored
    pd.testing.assert_frame_equal(found.effects, expected.effects)
    pd.testing.assert_frame_equal(found.cells, expected.cells)
    pd.testing.assert_frame_equal(
        found.repeats.reset_index(drop=True), expected.repeats.reset_index(drop=True)
    )


def test_the_pages_of_what_was_read_are_those_of_what_was_written(written: Path) -> None:
    """They depend on the order of the base readings, of choices, and of values."""
    assert pages(read(written)) == pages(multiverse())


def test_the_same_results_give_the_same_bytes(written: Path, tmp_path: Path) -> None:
    before = [(written / name).read_bytes() for name in FILES]
    write(read(written), tmp_path / "copy")
    assert [(tmp_path / "copy" / name).read_bytes() for name in FILES] == before


def test_a_folder_without_a_multiverse(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match=r"there is no multiverse in .*: run `python -m study.run"):
        read(tmp_path)


def test_another_format(written: Path) -> None:
    facts = json.loads((written / FACTS).read_text()) | {"format": 99}
    (written / FACTS).write_text(json.dumps(facts))
    with pytest.raises(BadInput, match="has the format 99"):
        read(written)


@pytest.mark.parametrize("name", FILES)
def test_a_damaged_file(written: Path, name: str) -> None:
    path = written / name
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with pytest.raises(StudyError, match="is damaged"):
        read(written)


@pytest.mark.parametrize("damage", [None, 3, {"settings": None}, {"versions": 3}])
def test_facts_of_another_kind(written: Path, damage: object) -> None:
    facts = json.loads((written / FACTS).read_text())
    content = facts | damage if isinstance(damage, dict) else damage
    (written / FACTS).write_text(json.dumps(content))
    with pytest.raises(StudyError, match="is damaged"):
        read(written)


@pytest.mark.parametrize("name", [CELLS, EFFECTS, REPEATS])
def test_a_table_without_universes(written: Path, name: str) -> None:
    table = pd.read_parquet(written / name)
    table.drop(columns="universe").to_parquet(written / name)
    with pytest.raises(StudyError, match="is damaged"):
        read(written)
