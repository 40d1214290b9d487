"""The search for β: its journal, its grid, and the score of a pruned trial."""

from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import optuna
import pytest
import torch
from optuna.distributions import FloatDistribution
from optuna.storages import JournalStorage
from optuna.storages.journal import JournalFileBackend
from optuna.trial import FrozenTrial, TrialState, create_trial

from study.common.files import read_json
from study.config.convert import from_json
from study.config.grid import Cell
from study.config.stage_settings import TuneSettings
from study.training import search as search_for_beta
from study.training.search import sampler, trial_to_json
from study.workflow.pipeline import Pipeline
from study.workflow.store import Store
from study.workflow.task import Task
from tests.helpers.running import SMALL, SMOKE, Done, configuration

CELL = Cell("cart", "low", "full_vae", 0)


def _task(arguments: list[str], cell: Cell) -> Task:
    return Pipeline(configuration(*arguments)).tune(cell)


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
    for trial, stored in zip(study.trials, tuning["trials"], strict=True):
        assert trial.params["beta"] == stored["beta"]
        assert tune["beta_low"] <= stored["beta"] <= tune["beta_high"]
        assert trial.state.name.lower() == stored["state"]
        assert {str(k): v for k, v in trial.intermediate_values.items()} == stored["intermediate"]
        last = trial.intermediate_values[max(trial.intermediate_values)]
        assert stored["score"] == (trial.value if trial.state.name == "COMPLETE" else last)
    scores = {t["score"]: t["beta"] for t in tuning["trials"] if t["state"] == "complete"}
    assert (tuning["score"], tuning["beta"]) == (min(scores), scores[min(scores)])
    assert (study.best_value, study.best_params["beta"]) == (tuning["score"], tuning["beta"])


@pytest.mark.parametrize("chosen", ["cpu", "cuda"])
def test_the_device_is_chosen_once(
    chosen: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All trials of a search have one device, those after a resumption as well."""
    measured: list[object] = []

    def fit_device(*arguments: object) -> torch.device:
        measured.append(arguments)
        return torch.device(chosen)

    monkeypatch.setattr(search_for_beta, "fit_device", fit_device)
    start: Any = Mock()
    start.train.accelerator = "auto"
    storage = JournalStorage(JournalFileBackend(str(tmp_path / "journal.log")))
    expected = {"cpu": "cpu", "cuda": "gpu"}[chosen]
    optuna.create_study(storage=storage, study_name="beta")
    for _ in range(2):
        search = optuna.load_study(storage=storage, study_name="beta")
        # Without a GPU nothing is stored, so a journal is the same as ever.
        monkeypatch.setattr(search_for_beta, "gpu", lambda accelerator: None)
        stored = dict(search.user_attrs)
        assert search_for_beta._settled_accelerator(search, start, 3) == "auto"
        assert search.user_attrs == stored
        monkeypatch.setattr(search_for_beta, "gpu", lambda accelerator: torch.device("cuda"))
        assert search_for_beta._settled_accelerator(search, start, 3) == expected
    assert len(measured) == 1
    start.train.accelerator = "gpu"
    assert search_for_beta._settled_accelerator(search, start, 3) == "gpu"


@pytest.mark.parametrize("environment", ["pusher", "uav"])
def test_the_fit_takes_the_tuned_beta(smoke: tuple[Path, Done], environment: str) -> None:
    pipeline = Pipeline(configuration(*SMOKE))
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
    settings = from_json(TuneSettings, task.settings)

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


def test_a_pruned_trial_has_the_score_of_its_last_report() -> None:
    def trial(state: TrialState, value: float | None, reports: dict[int, float]) -> FrozenTrial:
        return create_trial(
            state=state,
            value=value,
            params={"beta": 1.0},
            distributions={"beta": FloatDistribution(0.1, 10.0)},
            intermediate_values=reports,
        )

    reports = {100: 0.3, 150: 0.2, 50: 0.5}
    assert trial_to_json(0, trial(TrialState.PRUNED, None, reports))["score"] == 0.2
    assert trial_to_json(0, trial(TrialState.COMPLETE, 0.1, reports))["score"] == 0.1
    assert trial_to_json(0, trial(TrialState.PRUNED, None, {}))["score"] is None
