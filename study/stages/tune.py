"""Stage tune: Optuna searches β, uniformly in log β, by the score of validation forecasts.

Writes ``tuning.json`` (the best β and every trial) and ``journal.log``, an Optuna journal that
``optuna-dashboard`` opens. With `tune.storage`, a database has the trials instead of the journal.
A stopped search can be resumed, with the same result: a trial depends only on the cell's seed and
on the trials that ended before it.

With a `tune.batch` of more than one, the stages `trial` and `select` take its place.
"""

from collections.abc import Mapping
from pathlib import Path

import optuna

from study.common.files import write_json
from study.common.progress import Progress
from study.config.stage_settings import TuneSettings
from study.training.search import (
    ENDED,
    pruner,
    result_to_json,
    run_trial,
    sampler,
    suggest,
    trial_to_json,
)
from study.training.search_storage import (
    explained,
    fail_running,
    stored_search,
)

RESUMABLE = True
"""A new run of this stage may use the files of a stopped one, see `study.workflow.worker`."""


def run(settings: TuneSettings, inputs: Mapping[str, Path], out: Path, progress: Progress) -> None:
    """Run the stage."""
    with explained(settings.database):
        search = _open_search(settings, out)
        _run_trials(search, settings, inputs, out, progress)
        ended = search.get_trials(deepcopy=False, states=ENDED)
    trials = [trial_to_json(number, trial) for number, trial in enumerate(ended)]
    write_json(out / "tuning.json", result_to_json(trials))


def _run_trials(
    search: optuna.Study,
    settings: TuneSettings,
    inputs: Mapping[str, Path],
    out: Path,
    progress: Progress,
) -> None:
    """Run trials until as many have ended as the settings say."""
    count = settings.tune.trials
    while (index := len(search.get_trials(deepcopy=False, states=ENDED))) < count:
        search.sampler = sampler(index, settings)
        trial = search.ask()
        suggest(trial, settings.tune)
        part = progress.part(index / count, (index + 1) / count)
        run_trial(trial, settings, inputs, out, part)


def _open_search(settings: TuneSettings, out: Path) -> optuna.Study:
    """The search in `out` or in the database, new or resumed. An interrupted trial has failed."""
    search = stored_search(settings.database, out, settings.fit.model)
    search.pruner = pruner(settings.tune)
    fail_running(search)
    return search
