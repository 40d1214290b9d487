"""Stage select: the best β of a search whose trials ran in batches (stage trial).

Writes ``tuning.json`` and ``journal.log`` like the stage tune. With `tune.storage`, the database
has the trials instead of the journal.
"""

from collections.abc import Mapping
from pathlib import Path

from study.common.files import read_json, write_json
from study.common.progress import Progress
from study.config.stage_settings import SelectSettings
from study.training.search import result_to_json, trial_from_json
from study.training.search_storage import complete_search, explained, stored_search


def run(
    settings: SelectSettings, inputs: Mapping[str, Path], out: Path, progress: Progress
) -> None:
    """Run the stage."""
    trials = sorted(
        (read_json(folder / "trial.json") for folder in inputs.values()),
        key=lambda trial: int(trial["number"]),
    )
    with explained(settings.database):
        search = stored_search(settings.database, out, settings.model)
        complete_search(search, [trial_from_json(trial, settings.tune) for trial in trials])
    write_json(out / "tuning.json", result_to_json(trials))
