"""Stage tune: Optuna searches β, uniformly in log β, on forecasts of validation scenarios.

Writes ``tuning.json`` (the best β and every trial) and ``journal.log``, an Optuna journal that
``optuna-dashboard`` opens. A stopped search goes on where it was: what a trial does depends on the
cell's seed and on the trials that ended before it, and on nothing that a stop could change.
"""

import gc
from pathlib import Path
from typing import Any

import lightning as L
import numpy as np
import optuna
from lightning.pytorch.callbacks import Callback
from optuna.samplers import BaseSampler, PartialFixedSampler, TPESampler
from optuna.storages import JournalStorage
from optuna.storages.journal import JournalFileBackend
from optuna.trial import FrozenTrial, TrialState

from study.common.errors import StudyError
from study.common.files import write_json
from study.common.progress import Progress
from study.common.seeds import derive, torch_seed
from study.models import models
from study.training.fit import fit
from study.training.inputs import prepare

RESUMABLE = True
ENDED = (TrialState.COMPLETE, TrialState.PRUNED)


def run(settings: dict[str, Any], inputs: dict[str, Path], out: Path, progress: Progress) -> None:
    """See the module."""
    tune = settings["tune"]
    optuna.logging.enable_propagation()
    optuna.logging.disable_default_handler()
    study = optuna.create_study(
        study_name=f"beta of {settings['model']}",
        storage=JournalStorage(JournalFileBackend(str(out / "journal.log"))),
        # What a fit reaches in its first half is much the same for every β.
        pruner=optuna.pruners.MedianPruner(n_startup_trials=2, n_warmup_steps=tune["steps"] // 2),
        load_if_exists=True,
    )
    for stopped in study.get_trials(deepcopy=False, states=(TrialState.RUNNING,)):
        study.tell(stopped.number, state=TrialState.FAIL)
    while (index := len(study.get_trials(deepcopy=False, states=ENDED))) < tune["trials"]:
        study.sampler = sampler(index, settings)
        trial = study.ask()
        beta = trial.suggest_float("beta", tune["beta_low"], tune["beta_high"], log=True)
        part = progress.part(index / tune["trials"], (index + 1) / tune["trials"])
        report = Report(trial)
        score = _try(beta, settings, inputs, out, part, report)
        if report.pruned:
            study.tell(trial, state=TrialState.PRUNED)
        elif np.isfinite(score):
            study.tell(trial, score)
        else:
            raise StudyError(f"beta {beta:.3g}: the validation score is {score}")
    ended = study.get_trials(deepcopy=False, states=ENDED)
    write_json(
        out / "tuning.json",
        {
            "beta": study.best_params["beta"],
            "score": study.best_value,
            "trials": [_as_json(number, trial) for number, trial in enumerate(ended)],
        },
    )


def sampler(index: int, settings: dict[str, Any]) -> BaseSampler:
    """Of trial `index`: first an even cover of log β, then TPE with a seed of its own."""
    tune = settings["tune"]
    seed = torch_seed(derive(settings["seed"], "trial", index))
    startup = (tune["trials"] + 1) // 2
    base = TPESampler(n_startup_trials=startup, seed=seed)
    if index >= startup:
        return base
    # The middles of equal shares of the range, the outer ones last: pruning begins informed.
    share = (np.arange(startup) + 0.5) / startup
    order = np.argsort(np.abs(share - 0.5), kind="stable")
    low, high = np.log(tune["beta_low"]), np.log(tune["beta_high"])
    beta = float(np.exp(low + share[order[index]] * (high - low)))
    return PartialFixedSampler({"beta": beta}, base)


class Report(Callback):
    """Reports each validation score to Optuna, and stops a trial that is not worth going on."""

    def __init__(self, trial: optuna.Trial) -> None:
        self.trial, self.pruned = trial, False

    def on_validation_end(self, trainer: L.Trainer, _: L.LightningModule) -> None:
        """After each look."""
        score = float(trainer.callback_metrics["validation_score"])
        self.trial.report(score, trainer.global_step)
        if self.trial.should_prune():
            self.pruned = trainer.should_stop = True


def _try(
    beta: float,
    settings: dict[str, Any],
    inputs: dict[str, Path],
    out: Path,
    progress: Progress,
    report: Report,
) -> float:
    """The validation score after a short fit; all trials begin with the same weights."""
    tune = settings["tune"]
    sections = models[settings["model"]].trial_settings(settings["sections"])
    short = sections | {"train": sections["train"] | {"steps": tune["steps"]}}
    model, data = prepare(settings | {"sections": short}, inputs, beta, tune["validation"])
    model.validation_samples = tune["samples"]
    curves = out / "trial"
    score = fit(
        model,
        data,
        curves,
        progress,
        seed=settings["seed"],
        steps=tune["steps"],
        validate_every=tune["steps"] // tune["evaluations"],
        patience=None,
        accelerator=sections["train"]["accelerator"],
        callbacks=[report],
    )
    for file in curves.glob("*"):
        file.unlink()
    curves.rmdir()
    # Trainer and model hold each other: without this the data of every trial stay in memory.
    del model, data
    gc.collect()
    return score


def _as_json(number: int, trial: FrozenTrial) -> dict[str, Any]:
    return {
        "number": number,
        "beta": trial.params["beta"],
        "value": trial.value if trial.state == TrialState.COMPLETE else None,
        "state": "complete" if trial.state == TrialState.COMPLETE else "pruned",
        "intermediate": {str(step): value for step, value in trial.intermediate_values.items()},
    }
