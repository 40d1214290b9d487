"""Protection of the results of a multiverse that ``work/`` cannot compute again.

A results folder that was copied or joined has no ``work/``. A run of some of its universes would
remove the others, so it is refused. A run of all of them, with the same settings, is not.
"""

from collections.abc import Collection, Mapping
from pathlib import Path

from study.common.errors import StudyError
from study.config.settings import Config
from study.multiverse import folder
from study.multiverse.design import Universe
from study.multiverse.folder import REUSED, Multiverse
from study.results.multiverse import STATE, Tasks, is_own
from study.results.protection import differing_settings, dotted_settings, would_be_lost
from study.results.reuse import SEEDS
from study.workflow.store import Store


def why_refused(
    configs: Mapping[str, Config],
    computed: Collection[str],
    tasks: Tasks,
    store: Store,
    out: Path,
) -> str | None:
    """Why a run must not publish its results in a folder; None if it may.

    Args:
        configs: the settings of all universes of the design, by name.
        computed: the names of the universes that the run computes, or has computed, or takes from
            another multiverse, with all cells.
        tasks: of all cells of all universes.
        store: the folders of the tasks. A universe that is complete there can be published again.
        out: the results folder.
    """
    if not (out / folder.FACTS).is_file():
        return None
    try:
        present = folder.read(out)
    except StudyError as error:
        # The folder's own work/, or a complete run, can write it again.
        if (out / STATE).is_file() or set(computed) >= set(configs):
            return None
        return f"the results in {out} would be lost, and cannot be read ({error})"
    # The stages of a universe that was reused are elsewhere.
    protected = set(present.facts.get(REUSED, {}) if is_own(out) else present.scored)
    scored = [u for u in present.universes if u.name in protected]
    differing = {u.name: _different_settings(present, u, configs) for u in scored}
    lost = [
        universe.name
        for universe in scored
        if not (
            (universe.name in computed and not differing[universe.name])
            or is_complete(universe.name, tasks, store)
        )
    ]
    names = sorted({setting for name in lost for setting in differing[name]})
    return would_be_lost(lost, names, out) if lost else None


def _different_settings(
    present: Multiverse, universe: Universe, configs: Mapping[str, Config]
) -> list[str]:
    """The settings in which a universe differs from that of the same name in another design."""
    if universe.name not in configs:
        return ["multiverse"]
    old = present.settings(universe)
    new = dotted_settings(configs[universe.name])
    seeds = set(old[SEEDS])
    if universe.kind == "base":
        seeds |= set(present.design.further_seeds)
    if seeds <= set(new[SEEDS]):  # more seeds lose nothing
        old[SEEDS] = new[SEEDS]
    return differing_settings(old, new)


def is_complete(name: str, tasks: Tasks, store: Store) -> bool:
    """Whether all cells of a universe are evaluated in the store.

    Args:
        name: of the universe.
        tasks: of all cells of the universes.
        store: the folders of the tasks.
    """
    return name in tasks and all(store.reason_to_run(task) is None for task in tasks[name].values())
