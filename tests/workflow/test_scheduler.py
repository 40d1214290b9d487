"""Order, side by side, and what becomes of the rest when a task fails."""

from collections import Counter
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import pytest

from study.workflow.scheduler import POLL, run_tasks
from study.workflow.store import Store
from study.workflow.task import Task
from study.workflow.task_queue import longest_first
from study.workflow.worker import Outcome
from study.workflow.workers import Workers


class Pretend(Workers):
    """Ends tasks one at a time, the latest first, and runs none of them."""

    def __init__(self, ends: Callable[[Task], Outcome], workers: int) -> None:
        self.ends, self.open, self.most = ends, list[tuple[Task, Future[Any]]](), 0
        self.workers = workers

    def capacity(self) -> Mapping[str, int]:
        return {"": self.workers}

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        self.open.append((args[0], future))
        self.most = max(self.most, len(self.open))
        return future

    def end_one(self) -> None:
        task, future = self.open.pop()
        try:
            future.set_result(self.ends(task))
        except RuntimeError as error:
            future.set_exception(error)


def diamond() -> list[Task]:
    top = Task("collect", "top", {})
    sides = [Task("train", f"side {n}", {"n": n}, {"data": top}) for n in range(3)]
    alone = Task("collect", "alone", {"n": 9})
    last = Task("record", "last", {}, {"left": sides[0], "right": sides[1]})
    return [top, *sides, last, alone]


def go(
    store: Store, workers: int, ends: Callable[[Task], Outcome], monkeypatch: pytest.MonkeyPatch
) -> tuple[dict[str, str], list[str], int]:
    """The errors, the order in which tasks ended, and how many were open at most."""
    pretend, ended = Pretend(ends, workers), list[str]()

    def wait(futures: Any, **_: Any) -> tuple[set[Any], set[Any]]:
        if pretend.open:
            pretend.end_one()
        return {future for future in futures if future.done()}, set()

    monkeypatch.setattr("study.workflow.scheduler.wait", wait)
    errors = run_tasks(
        diamond(), store, pretend, 1, lambda _: None, lambda o: ended.append(o.task.label)
    )
    return {task.label: error for task, error in errors.items()}, ended, pretend.most


@pytest.mark.parametrize("workers", [1, 2, 3])
def test_after_what_it_reads_and_as_many_as_fit(
    workers: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    errors, ended, most = go(Store(tmp_path), workers, lambda t: Outcome(t, 1.0), monkeypatch)
    assert errors == {}
    assert len(ended) == len(set(ended)) == 6
    for task in diamond():
        for source in task.inputs.values():
            assert ended.index(source.label) < ended.index(task.label)
    assert most == workers


def test_the_others_finish(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store = Store(tmp_path)

    def ends(task: Task) -> Outcome:
        return Outcome(task, 1.0, "ValueError: no" if task.label == "side 1" else None)

    errors, ended, _ = go(store, 2, ends, monkeypatch)
    assert errors == {"side 1": "ValueError: no", "last": "not run: train side 1 failed"}
    assert len(ended) == 6
    failed = next(task for task in diamond() if task.label == "side 1")
    assert store.failure(failed).read_text() == "ValueError: no\n"


@pytest.mark.parametrize(("times", "error"), [(3, None), (4, "the worker was lost 4 times")])
def test_a_lost_worker_costs_a_try(
    times: int, error: str | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tries = Counter[str]()

    def ends(task: Task) -> Outcome:
        tries[task.label] += 1
        if task.label == "side 0" and tries[task.label] <= times:
            raise RuntimeError("killed\nby signal 9")
        return Outcome(task, 1.0)

    errors, ended, _ = go(Store(tmp_path), 2, ends, monkeypatch)
    assert tries.pop("side 0") == 4
    assert set(tries.values()) == {1}
    assert ("last" in tries) == (error is None)
    assert len(ended) == 6
    killed = "(RuntimeError: killed by signal 9)"
    failed = {"side 0": f"{error} {killed}", "last": "not run: train side 0 failed"}
    assert errors == ({} if error is None else failed)


def test_an_error_of_its_own_is_not_tried_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tries = Counter[str]()

    def ends(task: Task) -> Outcome:
        tries[task.label] += 1
        return Outcome(task, 1.0, "ValueError: no" if task.label == "alone" else None)

    errors, _, _ = go(Store(tmp_path), 2, ends, monkeypatch)
    assert errors == {"alone": "ValueError: no"}
    assert set(tries.values()) == {1}


def test_the_longest_way_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tasks = diamond()
    labels = [task.label for task in longest_first(tasks)]
    assert labels == ["top", "side 0", "side 1", "side 2", "last", "alone"]
    started = list[str]()
    pretend = Pretend(lambda task: Outcome(task, 1.0), 1)

    def wait(futures: Any, **_: Any) -> tuple[set[Any], set[Any]]:
        pretend.end_one()
        return {future for future in futures if future.done()}, set()

    monkeypatch.setattr("study.workflow.scheduler.wait", wait)
    run_tasks(
        [tasks[-1], *tasks[:-1]],
        Store(tmp_path),
        pretend,
        1,
        lambda task: started.append(task.label),
        lambda _: None,
    )
    assert started == ["top", "side 0", "side 1", "alone", "side 2", "last"]


def test_what_is_up_to_date_counts_for_nothing() -> None:
    """Of a long way that has been gone, what is left counts."""
    _, side, *_, last, alone = diamond()
    order = longest_first([alone, side, last])
    assert [task.label for task in order] == ["side 0", "alone", "last"]


def test_tasks_for_a_gpu_wait_for_one_and_others_do_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of three workers one has a GPU, which the three tasks train need."""

    class WithGpu(Pretend):
        def capacity(self) -> Mapping[str, int]:
            return {"": 3, "GPU": 1}

        def resource(self, task: Task) -> str:
            return "GPU" if task.stage == "train" else ""

    pretend, together = WithGpu(lambda task: Outcome(task, 1.0), 3), list[list[str]]()

    def wait(futures: Any, **_: Any) -> tuple[set[Any], set[Any]]:
        together.append(sorted(task.stage for task, _ in pretend.open))
        pretend.end_one()
        return {future for future in futures if future.done()}, set()

    monkeypatch.setattr("study.workflow.scheduler.wait", wait)
    assert not run_tasks(diamond(), Store(tmp_path), pretend, 1, lambda _: None, lambda _: None)
    assert max(stages.count("train") for stages in together) == 1
    assert together[0] == ["collect", "collect"]


def test_without_a_worker_for_what_is_left_it_waits_and_asks_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The only worker with a GPU is away when the tasks train are left, and comes back."""
    slept = list[float]()

    class Away(Pretend):
        def capacity(self) -> Mapping[str, int]:
            return {"": 1, "GPU": 1} if len(slept) > 2 else {"": 1}

        def resource(self, task: Task) -> str:
            return "GPU" if task.stage == "train" else ""

    pretend = Away(lambda task: Outcome(task, 1.0), 1)

    def wait(futures: Any, **_: Any) -> tuple[set[Any], set[Any]]:
        pretend.end_one()
        return {future for future in futures if future.done()}, set()

    monkeypatch.setattr("study.workflow.scheduler.wait", wait)
    monkeypatch.setattr("study.workflow.scheduler.time.sleep", slept.append)
    assert not run_tasks(diamond(), Store(tmp_path), pretend, 1, lambda _: None, lambda _: None)
    assert slept == [POLL] * 3
