"""Stage trial: one trial of a search for β whose trials run in batches.

Writes ``trial.json``. The trial depends on the cell's seed, its number and the trials of the
batches before, which are its inputs. So the trials of a batch run on any number of workers, in any
order. With `tune.storage`, the database shows the trial while it runs.
"""

from collections.abc import Mapping
from pathlib import Path

from study.common.files import read_json, write_json
from study.common.progress import Progress
from study.config.stage_settings import TrialSettings
from study.training.search import BETA, propose, run_trial, trial_from_json, trial_to_json
from study.training.search_storage import database_trial, explained


def run(settings: TrialSettings, inputs: Mapping[str, Path], out: Path, progress: Progress) -> None:
    """Run the stage."""
    tune, number = settings.tune, settings.number
    first = number // tune.batch * tune.batch
    earlier = (inputs[f"trial-{index}"] / "trial.json" for index in range(first))
    history = [trial_from_json(read_json(path), tune) for path in earlier]
    trial = propose(history, number, settings)
    beta = float(trial.params[BETA])
    with (
        explained(settings.database),
        database_trial(settings.database, number, beta, tune) as trial_copy,
    ):
        ended = run_trial(trial, settings, inputs, out, progress, trial_copy)
        if trial_copy is not None:
            trial_copy.end(ended)
    write_json(out / "trial.json", trial_to_json(number, ended))
