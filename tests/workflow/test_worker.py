"""A worker that was paused for longer than its lease, and continues."""

from pathlib import Path
from typing import Any

import pytest

from study.workflow import worker
from study.workflow.lease import LeaseLost, Terms
from study.workflow.store import Store
from study.workflow.worker import execute
from tests.helpers import chains


def test_it_removes_no_folder_of_its_successor(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store, (task, *_) = Store(tmp_path), chains.tasks(seconds=0.0)
    lease = store.lease(task)

    def paused(*_: Any) -> None:
        lease.write_text(lease.read_text().replace('"token": "', '"token": "other'))
        store.begin(task, False, "other")

    monkeypatch.setattr(worker, "prepare", paused)
    with pytest.raises(LeaseLost):
        execute(task, tmp_path, 1, Terms())
    assert store.partial(task, "other").is_dir()
    assert not store.is_complete(task)
    assert not store.failure(task).exists()


def test_a_stage_that_an_earlier_holder_completed_has_not_failed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store, (task, *_) = Store(tmp_path), chains.tasks(seconds=0.0)

    def overtaken(*_: Any) -> None:
        store.begin(task, False, "earlier")  # removes the folder of this attempt
        store.finish(task, {}, attempt="earlier")
        raise FileNotFoundError("the folder of this attempt")

    monkeypatch.setattr(worker, "run_stage", overtaken)
    assert execute(task, tmp_path, 1, Terms()).error is None
    assert store.is_complete(task)


def test_a_stage_that_fails_has_its_error(tmp_path: Path) -> None:
    chain = chains.tasks(seconds=0.0, broken=1)
    broken = next(task for task in chain if task.settings["error"])
    (source,) = broken.inputs.values()
    outcomes = [execute(task, tmp_path, 1, Terms()) for task in (source, broken)]
    assert [outcome.error for outcome in outcomes] == [None, "ValueError: this link is broken"]
