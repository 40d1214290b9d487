"""The search for β: its trials, and what is stored of them."""

import gc
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol

import lightning as L
import numpy as np
import optuna
from lightning.pytorch.callbacks import Callback
from optuna.distributions import FloatDistribution
from optuna.pruners import BasePruner, MedianPruner
from optuna.samplers import BaseSampler, PartialFixedSampler, TPESampler
from optuna.trial import FrozenTrial, TrialState, create_trial

from study.common.errors import StudyError
from study.common.progress import Progress
from study.common.seeds import derive, torch_seed
from study.config.convert import from_json, to_json
from study.config.settings import Tune
from study.config.stage_settings import TrainSettings, TuneSettings
from study.models import models
from study.training.fit import FitOptions, fit
from study.training.hardware import fit_device, gpu
from study.training.inputs import FitInputs, prepare, validation_trajectories
from study.training.validation import LogForecastScore, LogNegativeElbo

BETA = "beta"
"""The parameter of a trial."""
ACCELERATOR = "accelerator"
"""The attribute of a search with the accelerator that `auto` chose."""
STATES = {"complete": TrialState.COMPLETE, "pruned": TrialState.PRUNED}
"""The states of a trial that has ended, by their names in files."""
ENDED = tuple(STATES.values())


optuna.logging.enable_propagation()  # to the log file of the stage, and not to the terminal
optuna.logging.disable_default_handler()


class TrialCopy(Protocol):
    """A copy of a trial, such as the one in the database of the study."""

    def report(self, value: float, step: int) -> None:
        """Store an intermediate score."""


def suggest(trial: optuna.Trial, tune: Tune) -> float:
    """The β that the sampler of the search chooses for a trial."""
    return float(trial.suggest_float(BETA, tune.beta_low, tune.beta_high, log=True))


def propose(history: Sequence[FrozenTrial], number: int, settings: TuneSettings) -> optuna.Trial:
    """Propose the trial `number` of a search whose trials run in batches.

    The trials of its batch before it count as running. The sampler chooses the next β away from
    theirs (constant liar). So the β depends on the batches before, and on nothing else.

    Args:
        history: all trials of the batches before, in their order.
        number: of the trial.
        settings: of the search.

    Returns:
        the trial, of a search in memory. It has its β.
    """
    search = optuna.create_study(pruner=pruner(settings.tune))
    search.add_trials(history)
    for index in range(len(history), number + 1):
        search.sampler = sampler(index, settings)
        trial = search.ask()
        suggest(trial, settings.tune)
    return trial


def run_trial(
    trial: optuna.Trial,
    settings: TuneSettings,
    inputs: Mapping[str, Path],
    out: Path,
    progress: Progress,
    trial_copy: TrialCopy | None = None,
) -> FrozenTrial:
    """Fit a trial, and end it in its search.

    Args:
        trial: has its β. Its search has the earlier trials, with which the pruner compares.
        settings: of the search.
        inputs: the folders of the data, and of the ensemble if the model uses one.
        out: a folder for temporary files.
        progress: called with the fraction done.
        trial_copy: gets the intermediate scores as well.

    Raises:
        StudyError: the score is not finite.
    """
    search, beta = trial.study, float(trial.params[BETA])
    report = ReportToOptuna(trial, trial_copy)
    score = _short_fit(settings, inputs, out, progress, report)
    if report.pruned:
        return search.tell(trial, state=TrialState.PRUNED)
    if not np.isfinite(score):
        raise StudyError(
            f"beta {beta:.3g}: the validation score is {score}; "
            "change tune.beta_low or tune.beta_high"
        )
    return search.tell(trial, score)


def pruner(tune: Tune) -> BasePruner:
    """The pruner of a search, by the median of earlier trials.

    Scores of the first half of a fit hardly depend on β, so they prune no trial.
    """
    return MedianPruner(n_startup_trials=2, n_warmup_steps=tune.steps // 2)


def sampler(index: int, settings: TuneSettings) -> BaseSampler:
    """The sampler of trial `index`: an even grid in log β first, then TPE with its own seed.

    The constant liar counts the running trials of a batch as bad ones.
    """
    tune = settings.tune
    seed = torch_seed(derive(settings.fit.seed, "trial", index))
    startup = (tune.trials + 1) // 2
    tpe = TPESampler(n_startup_trials=startup, seed=seed, constant_liar=True)
    if index >= startup:
        return tpe
    return PartialFixedSampler({BETA: _grid(tune, startup)[index]}, tpe)


def _grid(tune: Tune, count: int) -> list[float]:
    """The middles of `count` equal parts of the range of log β, the inner ones first.

    Pruning compares with earlier trials, and inner values of β are the better reference.
    """
    fraction = (np.arange(count) + 0.5) / count
    order = np.argsort(np.abs(fraction - 0.5), kind="stable")
    low, high = np.log(tune.beta_low), np.log(tune.beta_high)
    return [float(np.exp(low + fraction[i] * (high - low))) for i in order]


class ReportToOptuna(Callback):
    """Reports every validation score to Optuna, and stops a trial that Optuna prunes.

    Args:
        trial: its search decides whether it is pruned.
        trial_copy: gets the scores as well.
    """

    def __init__(self, trial: optuna.Trial, trial_copy: TrialCopy | None = None) -> None:
        self.trial, self.trial_copy, self.pruned = trial, trial_copy, False

    def on_validation_end(self, trainer: L.Trainer, _: L.LightningModule) -> None:
        """After each validation."""
        score = float(trainer.callback_metrics["validation_score"])
        self.trial.report(score, trainer.global_step)
        if self.trial_copy is not None:
            self.trial_copy.report(score, trainer.global_step)
        if self.trial.should_prune():
            self.pruned = trainer.should_stop = True


def _short_fit(
    settings: TuneSettings,
    inputs: Mapping[str, Path],
    out: Path,
    progress: Progress,
    report: ReportToOptuna,
) -> float:
    """The validation score after a short fit. All trials start from the same weights."""
    tune, seed, beta = settings.tune, settings.fit.seed, float(report.trial.params[BETA])
    start = prepare(_trial_settings(settings), inputs, beta, tune.samples, tune.validation)
    options = FitOptions(
        seed,
        tune.steps,
        tune.steps // tune.evaluations,
        patience=None,
        accelerator=_settled_accelerator(report.trial.study, start, tune.steps),
        precision=start.train.precision,
    )
    curves = out / "trial"
    score = fit(
        start.model,
        start.data,
        curves,
        progress,
        options,
        [_score(start, tune), report],
    )
    for file in curves.glob("*"):
        file.unlink()
    curves.rmdir()
    # Trainer and model refer to each other. Without garbage collection the data of every trial
    # would stay in memory.
    del start
    gc.collect()
    return score


def _score(start: FitInputs, tune: Tune) -> Callback:
    """The callback that logs what the search minimises."""
    if tune.objective == "elbo":
        return LogNegativeElbo(validation_trajectories(start.model, start.data))
    return LogForecastScore(start.score)


def _settled_accelerator(search: optuna.Study, start: FitInputs, steps: int) -> str:
    """The accelerator of a trial.

    For the trials of one search, `auto` is measured once; a resumed search keeps the choice. A
    trial of a batch has a search in memory, so it measures for itself.

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


def result_to_json(trials: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """The content of ``tuning.json``: the best β and its score, and all trials."""
    complete = [trial for trial in trials if trial["state"] == "complete"]
    best = min(complete, key=lambda trial: float(trial["score"]))  # the first one of a tie
    return {BETA: best[BETA], "score": best["score"], "trials": list(trials)}


def trial_to_json(number: int, trial: FrozenTrial) -> dict[str, Any]:
    """A trial as JSON: β, state and score. The score of a pruned trial is its last report."""
    complete = trial.state == TrialState.COMPLETE
    reported = trial.intermediate_values
    last = reported[max(reported)] if reported else None
    return {
        "number": number,
        BETA: trial.params[BETA],
        "state": "complete" if complete else "pruned",
        "score": trial.value if complete else last,
        "intermediate": {str(step): value for step, value in reported.items()},
    }


def trial_from_json(trial: Mapping[str, Any], tune: Tune) -> FrozenTrial:
    """A trial that has ended, from what `trial_to_json` gave."""
    return create_trial(
        state=STATES[trial["state"]],
        value=trial["score"],
        params={BETA: trial[BETA]},
        distributions={BETA: FloatDistribution(tune.beta_low, tune.beta_high, log=True)},
        intermediate_values={int(step): value for step, value in trial["intermediate"].items()},
    )
