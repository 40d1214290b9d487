"""A search in batches has one result, for any number of workers and whatever is killed."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import optuna
import pytest
from optuna.trial import FrozenTrial, TrialState

from study.common.files import read_json, sha256
from study.config.convert import from_json
from study.config.grid import Cell
from study.config.settings import Engine
from study.config.stage_settings import Database, TrialSettings, TuneSettings
from study.training import search_storage
from study.training.search import (
    BETA,
    propose,
    pruner,
    sampler,
    suggest,
    trial_from_json,
    trial_to_json,
)
from study.training.search_storage import NUMBER, database, database_trial
from study.workflow.engine import start, terms
from study.workflow.lease import read_holder
from study.workflow.pipeline import Pipeline
from study.workflow.scheduler import run_tasks
from study.workflow.searches import with_database
from study.workflow.store import Store
from study.workflow.task import Task
from study.workflow.task_cache import topological_order
from study.workflow.worker import execute
from tests.helpers.running import ROOT, SMALL, configuration

CELL = Cell("cart", "low", "full_vae", 0)
TRIALS, BATCH = 7, 3
BATCHED = [*SMALL, f"--tune.trials={TRIALS}", f"--tune.batch={BATCH}"]


def search_tasks(*flags: str) -> list[Task]:
    """The tasks of the search of `CELL`, and its data."""
    config = configuration(*BATCHED, *flags)
    return with_database(topological_order([Pipeline(config).tune(CELL)]), config)


def search_files(root: Path) -> dict[str, str]:
    """The SHA-256 of the trials and of the result of a search."""
    paths = sorted(root.glob("t*/[!.]*/trial.json")) + list(root.glob("select/*/tuning.json"))
    return {str(path.relative_to(root)): sha256(path) for path in paths}


def curve(beta: float) -> dict[int, float]:
    """Scores of a trial by step, with the best β at 200."""
    return {step: abs(np.log(beta / 200)) + 1 / step for step in (50, 100, 150, 200)}


def run_synthetic(trial: optuna.Trial) -> FrozenTrial:
    """A trial with the scores of `curve`."""
    for step, score in curve(trial.params[BETA]).items():
        trial.report(score, step)
        if trial.should_prune():
            return trial.study.tell(trial, state=TrialState.PRUNED)
    return trial.study.tell(trial, score)


def synthetic_search(settings: TuneSettings) -> list[dict[str, Any]]:
    """The trials of a search in batches, as their files have them."""
    trials: list[dict[str, Any]] = []
    for number in range(settings.tune.trials):
        first = number // settings.tune.batch * settings.tune.batch
        history = [trial_from_json(trial, settings.tune) for trial in trials[:first]]
        trial = propose(history, number, settings)
        assert trial.number == number
        trials.append(trial_to_json(number, run_synthetic(trial)))
    return trials


def settings_of(batch: int) -> TuneSettings:
    task = Pipeline(configuration(*SMALL, "--tune.trials=16", "--tune.steps=200")).tune(CELL)
    settings: Mapping[str, Any] = task.settings
    tune = {**settings["tune"], "batch": batch}
    return from_json(TuneSettings, {**settings, "tune": tune})


def test_batches_of_one_trial_are_the_search_of_the_stage_tune() -> None:
    """So nothing that the sampler or the pruner needs is lost in the files of trials."""
    settings = settings_of(batch=1)
    search = optuna.create_study(pruner=pruner(settings.tune))
    for index in range(settings.tune.trials):
        search.sampler = sampler(index, settings)
        trial = search.ask()
        suggest(trial, settings.tune)
        run_synthetic(trial)
    expected = [trial_to_json(trial.number, trial) for trial in search.trials]
    assert {trial["state"] for trial in expected} == {"complete", "pruned"}
    assert synthetic_search(settings) == expected


def test_the_trials_of_a_batch_differ_and_the_search_finds_the_best() -> None:
    trials = synthetic_search(settings_of(batch=4))
    betas = np.log([trial["beta"] for trial in trials])
    for first in range(0, 16, 4):
        assert np.diff(np.sort(betas[first : first + 4])).min() > 1e-3
    assert min(abs(betas - np.log(200))) < 0.1
    assert betas[8:].std() < betas[:8].std()


def test_a_batch_of_one_is_no_batch() -> None:
    plain = Pipeline(configuration(*SMALL)).tune(CELL)
    assert plain.stage == "tune"
    assert "batch" not in plain.settings["tune"]
    assert Pipeline(configuration(*SMALL, "--tune.batch=1")).tune(CELL).key == plain.key


def test_a_trial_depends_on_the_batches_before() -> None:
    *others, last = search_tasks()
    trials = {task.label.rpartition("/")[2]: task for task in others if task.stage == "trial"}
    assert last.stage == "select"
    assert dict(last.inputs) == trials
    assert len(trials) == TRIALS
    for number in range(TRIALS):
        before = number // BATCH * BATCH
        inputs = trials[f"trial-{number}"].inputs.keys()
        assert inputs == {"data", *(f"trial-{index}" for index in range(before))}


def test_many_batches_are_planned_at_once() -> None:
    """The number of paths from the last task to the first grows exponentially."""
    config = configuration(*SMALL, "--tune.trials=100", "--tune.batch=2")
    assert len(topological_order([Pipeline(config).tune(CELL)])) == 102


@pytest.fixture(scope="module")
def serial(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The store of a search in this process."""
    store = Store(tmp_path_factory.mktemp("serial"))
    for task in search_tasks():
        assert execute(task, store.root, 1).error is None
    return store.root


def test_the_result_has_all_trials_and_a_journal(serial: Path) -> None:
    *_, task = search_tasks()
    folder = Store(serial).folder(task)
    tuning = read_json(folder / "tuning.json")
    assert [trial["number"] for trial in tuning["trials"]] == list(range(TRIALS))
    for name, source in task.inputs.items():
        trial = read_json(Store(serial).folder(source) / "trial.json")
        assert trial == tuning["trials"][int(name.removeprefix("trial-"))]
        settings = from_json(TrialSettings, source.settings)
        assert settings.tune.beta_low <= trial["beta"] <= settings.tune.beta_high
    complete = {t["score"]: t["beta"] for t in tuning["trials"] if t["state"] == "complete"}
    assert (tuning["score"], tuning["beta"]) == (min(complete), complete[min(complete)])
    storage = optuna.storages.JournalStorage(
        optuna.storages.journal.JournalFileBackend(str(folder / "journal.log"))
    )
    search = optuna.load_study(study_name="beta of full_vae", storage=storage)
    assert search.best_params == {"beta": tuning["beta"]}
    states = Counter(trial["state"] for trial in tuning["trials"])
    assert states == Counter(trial.state.name.lower() for trial in search.trials)


class Killer(threading.Thread):
    """Kills the first process that runs a trial."""

    def __init__(self, root: Path) -> None:
        super().__init__(daemon=True)
        self.root, self.killed = root, list[int]()

    def run(self) -> None:
        """Wait for a trial, and kill its process with SIGKILL."""
        deadline = time.monotonic() + 100
        while not self.killed and time.monotonic() < deadline:
            for path in self.root.glob("trial/.*.lease"):
                holder = read_holder(path)
                if holder is not None and holder.process != os.getpid():
                    os.kill(holder.process, signal.SIGKILL)
                    self.killed.append(holder.process)
                    return
            time.sleep(0.005)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("url", "workers"), [("sqlite", 1), ("sqlite", 2), ("postgresql", 3)], indirect=["url"]
)
def test_any_number_of_workers_gives_the_same_bytes(
    url: str, workers: int, serial: Path, tmp_path: Path
) -> None:
    """A worker is killed while it runs a trial."""
    store = Store(tmp_path / "work")
    tasks = search_tasks("--tune.storage", url)
    engine, lost = Engine(workers=workers), list[Task]()
    killer = Killer(store.root)
    killer.start()
    with start(engine, store.root, tasks) as pool:
        errors = run_tasks(
            tasks,
            store,
            pool,
            1,
            lambda _: None,
            lambda _: None,
            terms(engine),
            lambda task, _: lost.append(task),
        )
    assert errors == {}
    assert killer.killed
    assert [task.stage for task in lost] == ["trial"]
    assert search_files(store.root) == search_files(serial)
    states = Counter(trial.state for trial in trials_in(url))
    assert TrialState.RUNNING not in states
    assert states[TrialState.COMPLETE] + states[TrialState.PRUNED] == TRIALS


def trials_in(url: str) -> list[FrozenTrial]:
    """The trials of the only search of a database."""
    (summary,) = optuna.get_all_study_summaries(database(url))
    search = optuna.load_study(study_name=summary.study_name, storage=database(url))
    return list(search.trials)


def test_a_database_shows_the_trials_and_changes_nothing(
    serial: Path, tmp_path: Path, url: str
) -> None:
    """A process was killed in trial 1, and trial 0 ended before the database was given."""
    store, tasks = Store(tmp_path / "work"), search_tasks("--tune.storage", url)
    name = str(tasks[-1].services["database"]["search"])
    assert name == f"smoke/{CELL.name} {tasks[-1].key[:16]}"
    killed = optuna.create_study(storage=database(url), study_name=name).ask()
    killed.set_user_attr(NUMBER, 1)
    unrelated = {task.label: task for task in search_tasks()}
    for task in tasks:
        without = task.label.endswith("/trial-0")
        assert execute(unrelated[task.label] if without else task, store.root, 1).error is None
    assert search_files(store.root) == search_files(serial)
    assert not list(store.root.glob("select/*/journal.log"))
    first, *trials = trials_in(url)
    assert first.state == TrialState.FAIL
    tuning = read_json(store.folder(tasks[-1]) / "tuning.json")
    found = sorted(trials, key=lambda trial: int(trial.user_attrs[NUMBER]))
    shown = [trial_to_json(number, trial) for number, trial in enumerate(found)]
    assert shown == tuning["trials"]


def test_a_trial_that_fails_does_not_stay_running(tmp_path: Path) -> None:
    url = f"sqlite:///{tmp_path}/trials.db"
    tasks = search_tasks("--tune.storage", url, "--tune.batch=7")
    store = Store(tmp_path / "work")
    data, trial, *_ = tasks
    assert execute(data, store.root, 1).error is None
    (store.folder(data) / "kernel.json").write_text("{}")
    assert execute(trial, store.root, 1).error is not None
    assert [one.state for one in trials_in(url)] == [TrialState.FAIL]


def test_a_trial_that_is_stopped_as_it_begins_does_not_stay_running(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def stop(*_: object) -> float:
        raise SystemExit(143)

    monkeypatch.setattr(search_storage, "suggest", stop)
    url = f"sqlite:///{tmp_path}/trials.db"
    with (
        pytest.raises(SystemExit),
        database_trial(Database(url, "search"), 0, 100.0, configuration(*BATCHED).tune),
    ):
        pytest.fail("the trial has not begun")
    assert [one.state for one in trials_in(url)] == [TrialState.FAIL]


@pytest.mark.slow
def test_optuna_writes_nothing_to_the_terminal(tmp_path: Path) -> None:
    """In a new process, where no test has changed the handlers of Optuna."""
    code = (
        "from study.training.search import optuna\n"
        "optuna.create_study()\n"
        "import logging; print([*logging.getLogger('optuna').handlers])\n"
    )
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env=environment, cwd=tmp_path
    )
    assert (done.stdout, done.stderr) == ("[]\n", "")
