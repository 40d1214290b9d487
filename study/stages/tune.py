"""Stage tune: Optuna searches β, uniformly in log β, by the score of validation forecasts.

Writes ``tuning.json`` (the best β and every trial) and ``journal.log``, an Optuna journal that
``optuna-dashboard`` opens. With `tune.storage`, a database has the trials instead of the journal.
A stopped search can be resumed, with the same result: a trial depends only on the cell's seed and
on the trials that ended before it.
"""

import gc
from collections.abc import Mapping
from dataclasses import replace
from operator import attrgetter
from pathlib import Path
from typing import Any

import lightning as L
import numpy as np
import optuna
from lightning.pytorch.callbacks import Callback
from optuna.samplers import BaseSampler, PartialFixedSampler, TPESampler
from optuna.trial import FrozenTrial, TrialState

from study.common.errors import StudyError
from study.common.files import write_json
from study.common.progress import Progress
from study.common.seeds import derive, torch_seed
from study.config.convert import from_json, to_json
from study.config.settings import Tune
from study.config.stage_settings import TrainSettings, TuneSettings
from study.models import models
from study.training.fit import FitOptions, fit
from study.training.hardware import fit_device, gpu
from study.training.inputs import FitInputs, prepare
from study.training.search_storage import database, explained, journal
from study.training.validation import LogForecastScore

RESUMABLE = True
"""A new run of this stage may use the files of a stopped one, see `study.workflow.worker`."""
ACCELERATOR = "accelerator"
"""The search's attribute with the choice of `auto`."""
ENDED = (TrialState.COMPLETE, TrialState.PRUNED)


def run(settings: TuneSettings, inputs: Mapping[str, Path], out: Path, progress: Progress) -> None:
    """Run the stage."""
    with explained(settings.database.url if settings.database else None):
        search = _open_search(settings, out)
        _run_trials(search, settings, inputs, out, progress)
        ended = search.get_trials(deepcopy=False, states=ENDED)
    complete = (trial for trial in ended if trial.state == TrialState.COMPLETE)
    best = min(complete, key=attrgetter("value"))  # of equal ones the first
    write_json(
        out / "tuning.json",
        {
            "beta": best.params["beta"],
            "score": best.value,
            "trials": [trial_to_json(number, trial) for number, trial in enumerate(ended)],
        },
    )


def _run_trials(
    search: optuna.Study,
    settings: TuneSettings,
    inputs: Mapping[str, Path],
    out: Path,
    progress: Progress,
) -> None:
    """Run trials until as many have ended as the settings say.

    Raises:
        StudyError: a score is not finite.
    """
    tune = settings.tune
    while (index := len(search.get_trials(deepcopy=False, states=ENDED))) < tune.trials:
        search.sampler = sampler(index, settings)
        trial = search.ask()
        beta = trial.suggest_float("beta", tune.beta_low, tune.beta_high, log=True)
        part = progress.part(index / tune.trials, (index + 1) / tune.trials)
        report = ReportToOptuna(trial)
        score = _short_fit(beta, settings, inputs, out, part, report, search)
        if report.pruned:
            search.tell(trial, state=TrialState.PRUNED)
        elif np.isfinite(score):
            search.tell(trial, score)
        else:
            raise StudyError(
                f"beta {beta:.3g}: the validation score is {score}; "
                "change tune.beta_low or tune.beta_high"
            )


def _open_search(settings: TuneSettings, out: Path) -> optuna.Study:
    """The search in `out` or in the database, new or resumed. An interrupted trial has failed."""
    optuna.logging.enable_propagation()
    optuna.logging.disable_default_handler()
    shared = settings.database
    search = optuna.create_study(
        study_name=shared.search if shared else f"beta of {settings.fit.model}",
        storage=database(shared.url) if shared else journal(out / "journal.log"),
        # Scores of the first half of a fit hardly depend on β, so they prune no trial.
        pruner=optuna.pruners.MedianPruner(
            n_startup_trials=2, n_warmup_steps=settings.tune.steps // 2
        ),
        load_if_exists=True,
    )
    for stopped in search.get_trials(deepcopy=False, states=(TrialState.RUNNING,)):
        search.tell(stopped.number, state=TrialState.FAIL)
    return search


def sampler(index: int, settings: TuneSettings) -> BaseSampler:
    """The sampler of trial `index`: an even grid in log β first, then TPE with its own seed."""
    tune = settings.tune
    seed = torch_seed(derive(settings.fit.seed, "trial", index))
    startup = (tune.trials + 1) // 2
    tpe = TPESampler(n_startup_trials=startup, seed=seed)
    if index >= startup:
        return tpe
    return PartialFixedSampler({"beta": _grid(tune, startup)[index]}, tpe)


def _grid(tune: Tune, count: int) -> list[float]:
    """The middles of `count` equal parts of the range of log β, the inner ones first.

    Pruning compares with earlier trials, and inner values of β are the better reference.
    """
    fraction = (np.arange(count) + 0.5) / count
    order = np.argsort(np.abs(fraction - 0.5), kind="stable")
    low, high = np.log(tune.beta_low), np.log(tune.beta_high)
    return [float(np.exp(low + fraction[i] * (high - low))) for i in order]


class ReportToOptuna(Callback):
    """Reports every validation score to Optuna, and stops a trial that Optuna prunes."""

    def __init__(self, trial: optuna.Trial) -> None:
        self.trial, self.pruned = trial, False

    def on_validation_end(self, trainer: L.Trainer, _: L.LightningModule) -> None:
        """After each validation."""
        score = float(trainer.callback_metrics["validation_score"])
        self.trial.report(score, trainer.global_step)
        if self.trial.should_prune():
            self.pruned = trainer.should_stop = True


def _short_fit(
    beta: float,
    settings: TuneSettings,
    inputs: Mapping[str, Path],
    out: Path,
    progress: Progress,
    report: ReportToOptuna,
    search: optuna.Study,
) -> float:
    """The validation score after a short fit. All trials start from the same weights."""
    tune, seed = settings.tune, settings.fit.seed
    start = prepare(_trial_settings(settings), inputs, beta, tune.samples, tune.validation)
    options = FitOptions(
        seed,
        tune.steps,
        tune.steps // tune.evaluations,
        patience=None,
        accelerator=_settled_accelerator(search, start, tune.steps),
        precision=start.train.precision,
    )
    curves = out / "trial"
    score = fit(
        start.model,
        start.data,
        curves,
        progress,
        options,
        [LogForecastScore(start.score), report],
    )
    for file in curves.glob("*"):
        file.unlink()
    curves.rmdir()
    # Trainer and model refer to each other. Without garbage collection the data of every trial
    # would stay in memory.
    del start
    gc.collect()
    return score


def _settled_accelerator(search: optuna.Study, start: FitInputs, steps: int) -> str:
    """The accelerator of all trials: `auto` is measured once, and a resumed search goes on with it.

    Args:
        search: stores the choice, if there is one.
        start: of a fit.
        steps: of the fit.
    """
    accelerator = start.train.accelerator
    if accelerator != "auto" or gpu(accelerator) is None:
        return accelerator
    if ACCELERATOR not in search.user_attrs:
        start.model.on_training_data(start.data.training_states())
        device = fit_device(accelerator, start.model, start.data, steps)
        search.set_user_attr(ACCELERATOR, "cpu" if device.type == "cpu" else "gpu")
    return str(search.user_attrs[ACCELERATOR])


def _trial_settings(settings: TuneSettings) -> TrainSettings:
    """The settings of a trial's fit: `Model.trial_settings`, with the steps of a trial."""
    model = models[settings.fit.model]
    trial = model.trial_settings(from_json(model.settings_class, settings.fit.model_settings))
    short = replace(trial, train=replace(trial.train, steps=settings.tune.steps))
    return replace(settings.fit, model_settings=to_json(short))


def trial_to_json(number: int, trial: FrozenTrial) -> dict[str, Any]:
    """A trial as JSON: β, state and score. The score of a pruned trial is its last report."""
    complete = trial.state == TrialState.COMPLETE
    reported = trial.intermediate_values
    last = reported[max(reported)] if reported else None
    return {
        "number": number,
        "beta": trial.params["beta"],
        "state": "complete" if complete else "pruned",
        "score": trial.value if complete else last,
        "intermediate": {str(step): value for step, value in reported.items()},
    }
