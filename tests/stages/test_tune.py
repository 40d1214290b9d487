"""The search for β, as the smoke study left it."""

from pathlib import Path

import numpy as np
import optuna
import pytest
from optuna.storages import JournalStorage
from optuna.storages.journal import JournalFileBackend

from study.commands.parser import parse
from study.common.files import read_json
from study.common.trials import score
from study.config.grid import Cell
from study.stages.tune import sampler
from study.workflow.pipeline import Pipeline
from study.workflow.store import Store
from study.workflow.task import Task
from tests.helpers.running import SMALL, SMOKE, Done

CELL = Cell("cart", "low", "full_vae", 0)


def _task(arguments: list[str], cell: Cell) -> Task:
    return Pipeline(parse(["all", *arguments]).config).tune(cell)


def _study(journal: Path) -> optuna.Study:
    storage = JournalStorage(JournalFileBackend(str(journal)))
    (summary,) = optuna.get_all_study_summaries(storage)
    return optuna.load_study(study_name=summary.study_name, storage=storage)


def test_the_journal_opens_and_holds_what_the_stage_says(small: Path) -> None:
    task = _task(SMALL, CELL)
    folder = Store(small / "work").folder(task)
    study = _study(folder / "journal.log")
    tuning = read_json(folder / "tuning.json")
    tune = task.settings["tune"]
    assert study.direction == optuna.study.StudyDirection.MINIMIZE
    assert len(study.trials) == tune["trials"] == 4
    for trial, told in zip(study.trials, tuning["trials"], strict=True):
        assert trial.params["beta"] == told["beta"]
        assert tune["beta_low"] <= told["beta"] <= tune["beta_high"]
        assert trial.state.name.lower() == told["state"]
        assert {str(k): v for k, v in trial.intermediate_values.items()} == told["intermediate"]
    values = {t["value"]: t["beta"] for t in tuning["trials"] if t["state"] == "complete"}
    assert (tuning["score"], tuning["beta"]) == (min(values), values[min(values)])
    assert (study.best_value, study.best_params["beta"]) == (tuning["score"], tuning["beta"])


@pytest.mark.parametrize("environment", ["pusher", "uav"])
def test_the_fit_takes_the_tuned_beta(smoke: tuple[Path, Done], environment: str) -> None:
    pipeline = Pipeline(parse(["all", *SMOKE]).config)
    store = Store(smoke[0] / "work")
    for level in ("low", "high"):
        for model in ("residual_vae", "full_vae"):
            cell = Cell(environment, level, model, 0)
            tuned = read_json(store.folder(pipeline.tune(cell)) / "tuning.json")["beta"]
            fit = read_json(store.folder(pipeline.train(cell)) / "fit.json")["beta"]
            assert tuned == fit


def test_the_first_trials_cover_the_range_evenly_in_its_logarithm() -> None:
    changed = ["--tune.trials=8", "--tune.beta_low=1e-4", "--tune.beta_high=1"]
    task = _task([*SMOKE, *changed], Cell("uav", "low", "full_vae", 0))
    settings = dict(task.settings)

    def betas() -> list[float]:
        study = optuna.create_study()
        for index in range(8):
            study.sampler = sampler(index, settings)
            trial = study.ask()
            beta = trial.suggest_float("beta", 1e-4, 1.0, log=True)
            study.tell(trial, (np.log10(beta) + 3) ** 2)
        return [trial.params["beta"] for trial in study.trials]

    first = betas()
    assert np.diff(np.sort(np.log10(first[:4]))) == pytest.approx(np.full(3, 1.0))
    assert betas() == first


def test_a_pruned_trial_counts_by_its_last_report() -> None:
    reports = {"100": 0.3, "150": 0.2, "50": 0.5}
    assert score({"value": None, "intermediate": reports}) == 0.2
    assert score({"value": 0.1, "intermediate": reports}) == 0.1
    assert score({"value": None, "intermediate": {}}) is None
