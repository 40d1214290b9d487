"""Folders named by what made them: whole or not there, and found out when damaged."""

import os
import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pytest

from study.common.errors import StudyError
from study.common.files import read_json
from study.common.provenance import MANIFEST
from study.workflow.lease import LeaseLost
from study.workflow.store import Store
from study.workflow.task import Task


def task(value: int = 1, inputs: Mapping[str, Task] | None = None, **extra: Any) -> Task:
    return Task("train", "a/b", {"train": {"steps": value, "batch": 8}}, inputs or {}, **extra)


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return Store(tmp_path)


def finish(store: Store, of: Task, text: str = "weights") -> Path:
    out = store.begin(of, resumable=False)
    (out / "deep").mkdir()
    (out / "deep" / "model.bin").write_text(text)
    store.finish(of, {"seconds": 1.5})
    return store.folder(of)


def test_the_key_is_of_settings_and_inputs_alone() -> None:
    assert task().key == task().key
    assert task().key == task(plugins=("mine",)).key
    different = {task(2).key, task(inputs={"data": task(3)}).key, task(inputs={"x": task(3)}).key}
    assert len(different | {task().key, task(inputs={"data": task(4)}).key}) == 5


def test_finished_is_up_to_date(store: Store) -> None:
    assert store.reason_to_run(task()) == "missing"
    finish(store, task())
    assert store.reason_to_run(task()) is None
    assert store.timing(task()) == {"seconds": 1.5}
    assert not store.partial(task()).exists()


def test_the_same_task_leaves_the_same_manifest(store: Store) -> None:
    first = (finish(store, task()) / MANIFEST).read_bytes()
    assert (finish(store, task()) / MANIFEST).read_bytes() == first


def test_what_was_cut_off_is_not_finished(store: Store) -> None:
    for name in ("deep.json", "deep.safetensors"):
        (store.begin(task(), resumable=False) / name).write_text('{"cut": ')
        with pytest.raises(StudyError, match=f"{name} was not written completely"):
            store.finish(task(), {})
        assert store.reason_to_run(task()) == "missing"


def test_begun_is_not_finished(store: Store) -> None:
    (store.begin(task(), resumable=False) / "half").write_text("…")
    assert store.reason_to_run(task()) == "missing"


def test_what_was_left(store: Store) -> None:
    def left(resumable: bool) -> bool:
        return (store.begin(task(), resumable) / "half").exists()

    (store.begin(task(), resumable=True) / "half").write_text("…")
    assert left(resumable=True)
    assert not left(resumable=False)
    (store.begin(task(), resumable=True) / "half").write_text("…")
    store.failure(task()).parent.mkdir(parents=True, exist_ok=True)
    store.failure(task()).write_text("it may be why it failed\n")
    assert not left(resumable=True)
    assert not store.failure(task()).exists()


def test_each_attempt_has_a_folder_and_resumes_from_a_copy(store: Store) -> None:
    lost = store.begin(task(), resumable=True, attempt="lost")
    (lost / "half").write_text("a")
    still_open = (lost / "half").open("a")
    successor = store.begin(task(), resumable=True, attempt="next")
    assert successor != lost
    assert not lost.exists()
    still_open.write("b")  # the process that was believed to be lost goes on
    still_open.close()
    assert (successor / "half").read_text() == "a"


def test_the_first_complete_folder_stays(store: Store) -> None:
    outs = [store.begin(task(), False, "one"), store.partial(task(), "two")]
    outs[1].mkdir()
    for out, text in zip(outs, ("first", "second"), strict=True):
        (out / "model.bin").write_text(text)
    store.finish(task(), {}, attempt="one")
    outs[1].mkdir()
    (outs[1] / "model.bin").write_text("second")
    store.finish(task(), {}, attempt="two")
    assert (store.folder(task()) / "model.bin").read_text() == "first"
    assert not list(store.folder(task()).parent.glob(".*"))


def test_without_its_lease_a_folder_is_not_published(store: Store) -> None:
    (store.begin(task(), False, "lost") / "model.bin").write_text("late")

    def verify() -> None:
        raise LeaseLost

    with pytest.raises(LeaseLost):
        store.finish(task(), {}, attempt="lost", verify=verify)
    assert store.reason_to_run(task()) == "missing"


def test_a_folder_is_waited_for(store: Store) -> None:
    assert not store.is_visible(task(), seconds=0.0)
    later = threading.Timer(0.2, finish, (store, task()))
    later.start()
    assert store.is_visible(task(), seconds=30.0)
    later.join()


def _flip(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)


def _truncate(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def _swap(path: Path) -> None:
    """A folder where a file should be."""
    path.unlink()
    path.mkdir()


@pytest.mark.parametrize("harm", [_flip, _truncate, Path.unlink, _swap])
@pytest.mark.parametrize("name", ["deep/model.bin", MANIFEST])
def test_damage_is_named_and_made_good(
    store: Store, harm: Callable[[Path], None], name: str
) -> None:
    folder = finish(store, task())
    whole = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    harm(folder / name)
    assert store.reason_to_run(task()) == f"damaged: {folder / name}"
    finish(store, task())
    assert store.reason_to_run(task()) is None
    assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == whole


def test_every_bit_of_the_manifest_counts(store: Store) -> None:
    path = finish(store, task()) / MANIFEST
    whole = path.read_bytes()
    for position in range(len(whole)):
        path.write_bytes(whole[:position] + bytes([whole[position] ^ 2]) + whole[position + 1 :])
        damaged = store.reason_to_run(task())
        path.write_bytes(whole)
        # Of the facts that nobody acts upon, only what makes it unreadable is damage.
        acted_upon = whole.index(b'"files"') <= position < whole.index(b'"inputs"')
        assert damaged or not acted_upon, position
    assert store.reason_to_run(task()) is None


def test_why_it_has_to_run_says_what_changed(store: Store) -> None:
    data, other = Task("collect", "a", {"n": 1}), Task("collect", "a", {"n": 2})
    finish(store, task(1, {"data": data}))
    assert store.reason_to_run(task(2, {"data": data})) == "config changed: train.steps 1 → 2"
    assert store.reason_to_run(task(1, {"data": other})) == "input changed: data"
    assert store.reason_to_run(Task("train", "another", {})) == "missing"


def test_the_newest_folder_of_a_label_is_compared(store: Store) -> None:
    """Folders that are written after the first answer count."""
    os.utime(finish(store, task(1)) / MANIFEST, (0, 0))
    assert store.reason_to_run(task(4)) == "config changed: train.steps 1 → 4"
    os.utime(finish(store, task(2)) / MANIFEST, (2, 2))
    os.utime(finish(store, task(3)) / MANIFEST, (1, 1))
    os.utime(store.root / "train")
    assert store.reason_to_run(task(4)) == "config changed: train.steps 2 → 4"


def test_the_cost_of_a_reason_does_not_grow_with_the_study(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    count, opened = 20, list[Path]()

    def read(path: Path) -> Any:
        opened.append(path)
        return read_json(path)

    def steps(value: int) -> list[Task]:
        return [Task("train", f"cell-{n}", {"n": n, "steps": value}) for n in range(count)]

    for done in steps(1):
        finish(store, done)
    monkeypatch.setattr("study.workflow.store.read_json", read)
    reasons = {store.reason_to_run(due) for due in steps(2)}
    assert reasons == {"config changed: steps 1 → 2"}
    assert len(opened) == 2 * count  # once for the labels, and once for each task


def test_leftovers_of_killed_tasks_are_removed(store: Store) -> None:
    progress, lease = store.progress(task()), store.lease(task())
    for path in (progress, lease, lease.with_name(f"{lease.name}.0123456789ab")):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("{}")
    store.remove_leftovers()
    assert not progress.exists()
    assert list(lease.parent.iterdir()) == [lease]
