"""Protection of the results of a multiverse that ``work/`` cannot compute again.

A results folder that was copied or joined has no ``work/``. A run of some of its universes would
remove the others, so it is refused. A run of all of them, with the same settings, is not.
"""

import json
from collections.abc import Collection
from pathlib import Path

from study.common.errors import StudyError
from study.config.settings import Config
from study.multiverse import folder
from study.multiverse.design import Design
from study.results.folder import settings_of
from study.results.multiverse import STATE, Tasks
from study.results.protection import would_be_lost
from study.workflow.store import Store


def why_refused(
    config: Config, design: Design, tasks: Tasks, computed: Collection[str], store: Store, out: Path
) -> str | None:
    """Why a run must not publish its results in a folder; None if it may.

    Args:
        config: the settings that all universes share.
        design: the choices.
        tasks: of all universes of the design.
        computed: the names of the universes that the run computes completely.
        store: the folders of the tasks. A universe that is complete there can be published again.
        out: the results folder.
    """
    if (out / STATE).is_file():  # written from the stages in its own work/
        return None
    try:
        present = folder.read(out)
    except StudyError:  # there is none that could be read
        return None
    same_settings = present.facts["settings"] == json.loads(json.dumps(settings_of(config)))
    kept = {
        name
        for name in present.scored
        if name in tasks and all(store.reason_to_run(task) is None for task in tasks[name].values())
    }
    if same_settings:
        kept |= {
            universe.name
            for universe in present.universes
            if universe.name in computed
            and present.design.settings(universe.values) == design.settings(universe.values)
        }
    lost = [name for name in present.scored if name not in kept]
    return would_be_lost(lost, out) if lost else None
