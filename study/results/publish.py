"""Bring a results folder up to date with the folders of the stages.

Recordings, weights and illustrations of cells are copied. The other files
(`study.results.summary`) are written again if their inputs changed or if a file differs from
``SHA256SUMS``.
"""

from collections.abc import Collection, Mapping
from pathlib import Path

from study import __version__
from study.common.files import copy, digest, read_json, same_bytes, write_json
from study.config.grid import Cell, among
from study.config.settings import Config
from study.recording.integrity import checksum_path
from study.results import checksums
from study.results.folder import FORMAT, STUDY_RECORDING, settings_of
from study.results.origin import of_tasks, to_json
from study.workflow.failures import failed_stage
from study.workflow.source import source_digests
from study.workflow.store import Store
from study.workflow.task import Task
from study.workflow.task_cache import topological_order

Records = Mapping[Cell, Task]
"""The last task of every cell of the grid."""

CELL_FOLDERS = ("recordings", "weights", "illustrations")
"""Folders with files of single cells, and the recording of the whole study."""


def publish(config: Config, records: Records, store: Store, out: Path) -> bool:
    """Bring `out` up to date. The caller writes ``SHA256SUMS`` if anything changed.

    Args:
        config: settings of the study.
        records: the last task of every cell. A cell is left out if its last task is not complete,
            unless it is scored and only its recordings failed.
        store: the folders of the tasks.
        out: the results folder.

    Returns:
        whether anything was written.

    Raises:
        StudyError: a figure could not be drawn. All other files are written.
    """
    from study.results import summary

    complete = _published(records, store)
    if not complete:
        return False
    files = _cell_files(config, complete, store, out)
    changed = _remove_others(files, out)
    # A recording is copied before its checksum, which has a longer name. If the run stops between
    # the two, the recording counts as damaged.
    for target, source in sorted(files.items(), key=lambda pair: len(pair[0].name)):
        if not same_bytes(source, target):
            checksum_path(target).unlink(missing_ok=True)
            copy(source, target)
            changed = True
    failed = _failed(records, store)
    inputs = _inputs(config, complete, failed, store)
    if changed or _why_not_current(out, inputs):
        summary.write(summary.collect(config, complete, failed, store), out)
        write_json(_inputs_path(out), {"inputs": inputs})
        changed = True
    return changed


def why_not_published(
    config: Config, records: Records, store: Store, out: Path, due: Collection[Task]
) -> str | None:
    """Why `publish` would write a file after the tasks `due` have run; None if it would not."""
    complete = _published(records, store, due)
    failed = [] if due else _failed(records, store)
    why = _why_not_current(out, _inputs(config, complete, failed, store))
    return why or ("input changed" if due else None)


def _published(records: Records, store: Store, due: Collection[Task] = ()) -> Records:
    """The cells with results, after the tasks `due` have run.

    A cell has results even if its recording could not be written.
    """

    def is_scored(task: Task) -> bool:
        has_scores = store.reason_to_run(task.inputs["evaluation"]) is None
        return has_scores and failed_stage(task, store) is not None

    return {
        cell: task
        for cell, task in records.items()
        if task in due or store.reason_to_run(task) is None or is_scored(task)
    }


def _failed(records: Records, store: Store) -> list[str]:
    """Names of the cells without scores because one of their stages failed."""
    return [
        cell.name
        for cell, task in records.items()
        if failed_stage(task, store) and failed_stage(task.inputs["evaluation"], store)
    ]


def _inputs(config: Config, complete: Records, failed: list[str], store: Store) -> str:
    """Hash of all that the summary depends on."""
    cells = {cell.name: task.key for cell, task in complete.items()}
    source = dict(source_digests(("study.results.summary",)))
    origin = to_json(of_tasks(topological_order(complete.values()), store))
    return digest([FORMAT, __version__, source, origin, settings_of(config), cells, failed])


def _inputs_path(out: Path) -> Path:
    """The file with the hash of the inputs from which the summary was written."""
    return out / "work" / "summary.json"


def _why_not_current(out: Path, inputs: str) -> str | None:
    """Why the summary, or a file of a cell, has to be written; None if not."""
    try:
        written = read_json(_inputs_path(out))["inputs"]
    except (OSError, ValueError, KeyError, TypeError):
        return "missing"
    if written != inputs:
        return "input changed"
    if not (out / checksums.NAME).is_file():
        return f"missing: {out / checksums.NAME}"
    return next(iter(checksums.problems(out)), None)


def _cell_files(config: Config, complete: Records, store: Store, out: Path) -> dict[Path, Path]:
    """The files of cells that belong into `out`: the source of each, by its target."""
    files = {}
    published = config.publish
    for cell, task in complete.items():
        for path in store.folder(task).glob("*.rrd*"):
            is_forecast = path.name.startswith("forecast.")
            if among(cell, published.forecasts if is_forecast else published.recordings):
                files[out / "recordings" / cell.name / path.name] = path
        for path in store.folder(task.inputs["data_recording"]).glob("*.rrd*"):
            files[out / "recordings" / cell.environment / path.name] = path
        if "trained" in task.inputs and among(cell, published.weights):
            weights = store.folder(task.inputs["trained"]) / "model.safetensors"
            files[out / "weights" / f"{cell.name}.safetensors"] = weights
        illustration = store.folder(task.inputs["evaluation"]) / "illustration.safetensors"
        if illustration.is_file() and among(cell, published.recordings):
            files[out / "illustrations" / f"{cell.name}.safetensors"] = illustration
    return files


def _remove_others(files: Mapping[Path, Path], out: Path) -> bool:
    """Remove the files of cells that are no longer part of the results."""
    recording = out / STUDY_RECORDING
    expected = {*files, recording, checksum_path(recording)}
    obsolete = [
        path
        for folder in CELL_FOLDERS
        for path in (out / folder).rglob("*")
        if path.is_file() and path not in expected
    ]
    for path in obsolete:
        path.unlink()
        for folder in path.relative_to(out).parents[:-2]:  # all but `recordings` and the like
            if not any((out / folder).iterdir()):
                (out / folder).rmdir()
    return bool(obsolete)
