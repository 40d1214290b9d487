"""The cost of the stages: measured, written, and added up only where it is known."""

import io
import json
import os
import re
import shutil
import socket
import subprocess
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console
from rich.table import Table

from study.commands import status
from study.commands.status import INTERVAL, UNKNOWN, cost_table, duration_line
from study.common.files import read_json, write_json
from study.common.progress import Progress
from study.workflow import meter
from study.workflow.lease import Terms, hold
from study.workflow.lock import LEASE, is_locked, locked
from study.workflow.store import Store
from study.workflow.task import Task
from study.workflow.task_cache import record_tasks, topological_order
from tests.helpers.running import ROOT, SMALL, configuration, start, study

MEGABYTE = 1_000_000


def timing(minute: int, seconds: float, **others: float) -> dict[str, Any]:
    return {"began": f"2020-01-01T00:{minute:02d}:00.000+00:00", "seconds": seconds} | others


def lines(timings: Sequence[tuple[str, dict[str, Any]]]) -> dict[str, list[str]]:
    """The columns after the stage's name, by stage."""
    out = io.StringIO()
    Console(file=out, width=120).print(cost_table(timings))
    found = [line.split() for line in out.getvalue().splitlines()[3:]]
    return {words[0]: words[1:] for words in found if words and "─" not in words[0]}


def test_a_table_by_stage() -> None:
    measured = timing(0, 30, cpu_seconds=28.0, peak_memory=100 * MEGABYTE)
    larger = timing(0, 30, cpu_seconds=29.0, peak_memory=300 * MEGABYTE)
    table = lines(
        [("train", measured), ("train", larger), ("collect", timing(1, 40.0)), ("record", {})]
    )
    assert table == {
        "train": ["2", "60.0", "57.0", "60%", "300"],
        "collect": ["1", "40.0", "–", "40%", "–"],
        "record": ["0", "of", "1", "–", "–", "–", "–"],
        "all": ["3", "of", "4", "100.0", "–", "100%", "300"],
    }


def test_duration_and_how_busy() -> None:
    two = [
        timing(0, 60, cpu_seconds=60.0, threads=1),
        timing(1, 40, cpu_seconds=30.0, threads=1),
        timing(0, 100, cpu_seconds=90.0, threads=1),
    ]
    assert duration_line(two, 2) == "100 s from first start to last end; 2 cores, 90% busy"
    assert duration_line(two[-1:], 1) == "100 s from first start to last end; 1 core, 90% busy"


@pytest.mark.parametrize(
    "last", [timing(1, 40), timing(1, 40, cpu_seconds=9.0, threads=2), timing(1, 40, threads=1)]
)
def test_how_busy_is_not_guessed(last: dict[str, Any]) -> None:
    first = timing(0, 60, cpu_seconds=60.0, threads=1)
    assert duration_line([first, last], 2) == "100 s from first start to last end"


def test_several_parts() -> None:
    assert (
        duration_line([timing(0, 60), timing(1, 30), timing(9, 10)], 2)
        == "it ran in 2 parts, 100 s in all"
    )


def test_no_duration_until_all_have_run() -> None:
    assert duration_line([timing(0, 60), {}], 2) == duration_line([], 2) == ""


def test_every_task_leaves_its_numbers(small: Path) -> None:
    timings = read_json(small / "timings.json")
    tasks = timings["seconds"].keys()
    assert timings["workers"] == 1
    assert timings["cpu_seconds"].keys() == tasks
    assert min(timings["cpu_seconds"].values()) > 0
    if meter._reset_peak():
        assert timings["peak_memory"].keys() == tasks
        assert min(timings["peak_memory"].values()) > 10 * MEGABYTE
    text = study("status", *SMALL, "--out", small).out
    total = text.splitlines()[-3].split()
    assert (total[:2], total[4]) == (["all", str(len(tasks))], "100%")
    assert UNKNOWN not in total[:5]
    assert "from first start to last end; 1 core, " in text


def test_results_of_earlier_versions_show(copied: Path) -> None:
    paths = list(copied.glob("work/*/*/timing.json"))
    for path in paths:
        old = read_json(path)
        write_json(path, {"seconds": old["seconds"], "began": old["began"]})
    (copied / "timings.json").write_text("{}")
    done = study("status", *SMALL, "--out", copied)
    assert done.code == 0
    (total,) = [line.split() for line in done.out.splitlines() if line.strip().startswith("all ")][
        1:
    ]
    assert (total[1], total[3:]) == (str(len(paths)), ["–", "100%", "–"])
    assert "busy" not in done.out
    assert done.out.endswith("from first start to last end\n")
    part = study("status", *SMALL, "--out", copied, "--only", "*/drift/*")
    assert "cost of the stages" in part.out
    assert "from first start" not in part.out


@pytest.mark.slow
def test_published_results_without_their_stages_are_done() -> None:
    out = ROOT / "results" / "paper"
    assert not (out / "work").exists()
    for cells in ("uav/low/full_vae/seed-0", "uav/low/oracle/seed-0"):
        shown = study("status", "--out", out, "--only", cells)
        assert shown.code == 0
        assert "to do" not in shown.out
        assert "the stages ran elsewhere" in shown.out
    assert not (out / "work").exists()


def _running(copied: Path) -> Task:
    """The state in which a process of this machine runs a stage of the study."""
    store = Store(copied / "work")
    tasks = record_tasks(configuration(*SMALL), store).values()
    task = next(task for task in topological_order(tasks) if task.stage == "train")
    shutil.rmtree(store.folder(task))
    Progress(store.progress(task))(0.25, "step 5")
    return task


def test_where_a_stage_runs_since_when_and_how_often_it_was_tried(copied: Path) -> None:
    path = Store(copied / "work").lease(_running(copied))
    with hold(path, Terms(run="a")) as first:
        left = path.read_bytes()
    path.write_text(json.dumps(json.loads(left) | {"process": 2**22 + 1}))  # it was killed
    with locked(copied), hold(path, Terms(run="a")) as second:
        assert (first.attempt, second.attempt) == (1, 2)
        lines = study("status", *SMALL, "--out", copied).out.splitlines()
    (head,) = [line.split() for line in lines if " where " in line]
    assert head == ["stage", "for", "state", "where", "since", "attempt", "seconds", "device"]
    (shown,) = [line for line in lines if "running 25% step 5" in line]
    assert f"{socket.gethostname()}, process {os.getpid()}" in shown
    assert re.search(r"  \d\d:\d\d:\d\d +2 *$", shown)
    assert " where " not in study("status", *SMALL, "--out", copied).out  # the run has ended


def test_follow_ends_with_the_run(copied: Path) -> None:
    _running(copied)
    process = start("status", *SMALL, "--follow", "--out", copied)
    with locked(copied), pytest.raises(subprocess.TimeoutExpired):
        process.communicate(timeout=INTERVAL + 1)
    out, err = process.communicate()
    assert (process.returncode, err) == (0, "")
    assert "a run is going on" not in out
    assert out.count("cost of the stages") == 1


def test_follow_ends_if_the_machine_of_the_run_was_lost(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(status, "INTERVAL", 0.1)
    with locked(tmp_path, Terms(seconds=0.5)):
        left = read_json(tmp_path / LEASE) | {"system": "elsewhere"}
    write_json(tmp_path / LEASE, left)
    began = time.monotonic()
    status._follow(Table, tmp_path, Console(file=io.StringIO()))
    assert 0.5 < time.monotonic() - began < 5
    assert is_locked(tmp_path)


def test_follow_draws_again_in_a_terminal(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The run ends while the table is shown for the second time."""
    states = iter([True, True, False])
    monkeypatch.setattr(status, "is_locked", lambda *_: next(states))
    monkeypatch.setattr(status, "INTERVAL", 0.01)
    drawn = iter(range(10))
    terminal = Console(file=io.StringIO(), force_terminal=True)

    def table() -> Table:
        return Table("stage", title=f"drawing {next(drawn)}")

    status._follow(table, tmp_path, terminal)
    text = terminal.file.getvalue()  # type: ignore[attr-defined]
    assert "drawing 0" in text
    assert "drawing 1" in text
    assert next(drawn) == 2


@pytest.mark.parametrize("width", [80, 120])
def test_follow_shows_what_runs_and_what_failed(copied: Path, width: int) -> None:
    """In full, in a terminal of 80 columns as well."""
    store = Store(copied / "work")
    runs = _running(copied)
    tasks = topological_order(record_tasks(configuration(*SMALL), store).values())
    failed = next(task for task in tasks if task.stage == "tune")
    shutil.rmtree(store.folder(failed))
    error = "the validation score is nan; " * 5 + "change tune.beta_low"
    store.failure(failed).write_text(error)
    missing = next(task for task in tasks if task.stage == "evaluate")
    shutil.rmtree(store.folder(missing))
    terminal = Console(file=io.StringIO(), width=width)
    with hold(store.lease(runs), Terms(run="a")):
        costs = {task: store.timing(task) for task in tasks}
        terminal.print(status.follow_table(costs, store, copied))
    text = terminal.file.getvalue()  # type: ignore[attr-defined]
    assert f"{len(tasks) - 3} of {len(tasks)} stages are done" in " ".join(text.split())
    cells = "".join(text.split())  # without line breaks
    assert "running25%" in cells
    assert str(os.getpid()) in text
    assert "…" not in text
    rows = [line.split()[0] for line in text.splitlines() if line[:3].strip() and line.split()]
    assert {"tune", "train"} <= set(rows)
    assert not {"evaluate", "collect"} & set(rows)


def test_names_and_errors_are_complete_in_a_narrow_terminal(copied: Path) -> None:
    store = Store(copied / "work")
    task = _running(copied)
    tasks = topological_order(record_tasks(configuration(*SMALL), store).values())
    terminal = Console(file=io.StringIO(), width=80)
    with hold(store.lease(task), Terms(run="a")):
        costs = {task: store.timing(task) for task in tasks}
        terminal.print(status.state_table(costs, store, copied, is_running=True))
    text = terminal.file.getvalue()  # type: ignore[attr-defined]
    assert "…" not in text
    assert {task.stage for task in tasks} <= set(text.split())
