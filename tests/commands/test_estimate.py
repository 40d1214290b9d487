"""The estimate of the time of tasks: in proportion to their work, and to tasks that have ended."""

from pathlib import Path
from typing import Any

import pytest

from study.commands.estimate import SECONDS, SMALLEST, estimate, in_words, work
from study.common.files import read_json, write_json
from study.workflow.store import TIMING, Store
from study.workflow.task import Task
from tests.helpers.running import ROOT, study


def fit(steps: int, batch: int = 12, environment: str = "pusher") -> Task:
    settings: dict[str, Any] = {"model_settings": {"train": {"steps": steps, "batch_size": batch}}}
    return Task("train", f"{environment}/low/full_vae/seed-0", settings)


def test_the_work_of_each_stage() -> None:
    counts = {"trajectories": 100, "scenarios": 5, "rollouts": 10}
    data = Task("collect", "pusher", {"collect": counts})
    assert work(data) == 150
    assert work(fit(100, 24)) == 200
    train = fit(100, 24).settings
    tune = Task("tune", "a", {"fit": train, "tune": {"trials": 3, "steps": 10}})
    assert work(tune) == 60
    assert work(Task("trial", "a", tune.settings)) == 20
    ensemble = Task("ensemble", "a", {"ensemble": {"steps": 10, "batch_size": 6}})
    assert work(ensemble) == 5
    evaluate = Task("evaluate", "a", {"evaluate": {"samples": 7}}, {"data": data})
    assert work(evaluate) == 35


def test_without_ended_tasks_the_estimate_is_in_proportion_to_the_steps(tmp_path: Path) -> None:
    store = Store(tmp_path)
    assert estimate([fit(1000)], [], store) == pytest.approx(1000 * SECONDS["train"])
    assert estimate([fit(1000), fit(3000)], [], store) == pytest.approx(4000 * SECONDS["train"])
    assert estimate([fit(1)], [], store) == SMALLEST
    assert estimate([], [], store) == 0


def test_ended_tasks_of_the_same_stage_and_environment_count(tmp_path: Path) -> None:
    store, ended = Store(tmp_path), fit(1000)
    write_json(store.folder(ended) / TIMING, {"cpu_seconds": 5.0})
    assert estimate([fit(2000)], [ended], store) == pytest.approx(10.0)
    other = fit(2000, environment="uav")
    assert estimate([other], [ended], store) == pytest.approx(2000 * SECONDS["train"])


@pytest.mark.parametrize(
    ("seconds", "expected"),
    [(0.2, "1 s"), (40, "40 s"), (600, "10 min"), (12_600, "3.5 h")],
)
def test_durations_in_words(seconds: float, expected: str) -> None:
    assert in_words(seconds) == expected


def test_the_duration_on_many_workers_from_published_timings() -> None:
    out = ROOT / "results" / "paper"
    published = read_json(out / "timings.json")["seconds"]
    seconds = {
        name: took for name, took in published.items() if "/seed-" not in name or "/seed-0" in name
    }
    lines = study("plan", "--out", out, "--workers", 1, "--grid.seeds", "[0]").out.splitlines()
    (first,) = [index for index, line in enumerate(lines) if line.startswith("on 1 worker: ")]
    assert f"about {in_words(sum(seconds.values()))}, 100% busy, " in lines[first]
    assert f"durations from {len(seconds)} stages" in lines[first]
    chain = [" ".join(line.split()[:2]) for line in lines[first + 2 :]]
    assert lines[first + 1] == f"critical path, {in_words(sum(seconds[n] for n in chain))}:"
    assert not (out / "work").exists()


def test_a_number_of_workers_that_cannot_be() -> None:
    done = study("plan", "--workers", 0)
    assert done.code == 2
    assert done.err == "error: --workers: got 0; it must be at least 1\n"
