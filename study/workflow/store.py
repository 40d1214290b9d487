"""Content-addressed folders: the output of a stage, in a folder whose name is the task's key.

A task's key is a hash of its settings, its source and the keys of its inputs. So a changed setting
leads to another folder, and folders of tasks that do not depend on the setting stay valid. A stage
writes into a temporary folder, which gets its final name when it is complete. The manifest of a
folder holds the SHA-256 of every file.

Several workers may share the folders on a file server. Each attempt at a task writes into a
temporary folder of its own, and the first complete folder stays. So a worker that was believed to
be lost cannot write into the folder of its successor.
"""

import json
import os
import shutil
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from study.common.files import read_json, sha256, write_json
from study.common.provenance import MANIFEST
from study.common.read_back import read_back
from study.workflow.lease import remove_abandoned
from study.workflow.task import Task

TIMING = "timing.json"
"""Wall time, CPU time and memory. These differ between runs, so the manifest excludes them."""

CACHED = 90.0
"""Seconds for which a file server's client may not see a new folder of another machine. NFS keeps
the names of a folder for up to 60 seconds by default."""


class Store:
    """The folders of all tasks, under the folder `root`."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self._newest: dict[str, tuple[int, Mapping[str, Path]]] = {}

    def folder(self, task: Task) -> Path:
        """The folder of the task's complete output."""
        return self.root / task.stage / task.key[:16]

    def partial(self, task: Task, attempt: str = "") -> Path:
        """The folder into which the task writes while it runs.

        Args:
            task: the task.
            attempt: identifies the attempt at the task, where several workers share the store.
        """
        return self.root / task.stage / f".{task.key[:16]}{'.' * bool(attempt)}{attempt}.partial"

    def lease(self, task: Task) -> Path:
        """The file that names the process that runs the task (`study.workflow.lease`)."""
        return self.root / task.stage / f".{task.key[:16]}.lease"

    def log(self, task: Task) -> Path:
        """The log of the task's last run."""
        return self.root / "logs" / f"{task.stage}-{task.key[:16]}.log"

    def progress(self, task: Task) -> Path:
        """The file in which a running task reports its progress."""
        return self.log(task).with_suffix(".progress")

    def remove_leftovers(self) -> None:
        """Remove the progress files and the unfinished leases that killed tasks left."""
        for path in (self.root / "logs").glob("*.progress"):
            path.unlink(missing_ok=True)
        for folder in self.root.glob("[!.]*/"):
            remove_abandoned(folder, ".*.lease")

    def failure(self, task: Task) -> Path:
        """The file with the error of the task's last run, in one line; missing if it succeeded."""
        return self.log(task).with_suffix(".error")

    def begin(self, task: Task, resumable: bool, attempt: str = "") -> Path:
        """The folder to write into: empty, or, if `resumable`, with the files of a stopped run.

        The files are copied, since the process that was stopped may continue and write to them.
        The files of a failed run are always removed, since they may have caused the failure.
        """
        out = self.partial(task, attempt)
        leftovers = self._leftovers(task)
        previous = [path for path in leftovers if path.suffix == ".partial"]
        new = out.with_suffix(".new")
        new.mkdir(parents=True, exist_ok=True)
        if resumable and previous and not self.failure(task).exists():
            shutil.copytree(previous[-1], new, dirs_exist_ok=True)
        for path in leftovers:
            shutil.rmtree(path, ignore_errors=True)
        self.failure(task).unlink(missing_ok=True)
        new.replace(out)
        return out

    def discard(self, task: Task, attempt: str = "") -> None:
        """Remove the temporary folder of an attempt."""
        shutil.rmtree(self.partial(task, attempt), ignore_errors=True)

    def finish(
        self,
        task: Task,
        timing: Mapping[str, Any],
        runtime: Mapping[str, Any] | None = None,
        attempt: str = "",
        verify: Callable[[], None] | None = None,
    ) -> None:
        """Complete the folder: write checksums and manifest, and rename it into place.

        Args:
            task: the task.
            timing: what it cost; differs from run to run.
            runtime: with what it was computed (`study.models.runtime`), for the manifest.
            attempt: that of `begin`.
            verify: called just before the folder gets its name; raises if it must not.

        Raises:
            StudyError: a file cannot be read back.
        """
        out = self.partial(task, attempt)
        files = {}
        for path in sorted(out.rglob("*")):
            if path.is_file() and path.name not in (MANIFEST, TIMING):
                read_back(path)
                files[str(path.relative_to(out))] = sha256(path)
        manifest = {
            "stage": task.stage,
            "label": task.label,
            "key": task.key,
            "source": dict(task.source),
            "settings": dict(task.settings),
            "inputs": {name: source.key for name, source in task.inputs.items()},
            "files": files,
            "runtime": dict(runtime or {}),
        }
        write_json(out / TIMING, timing)
        write_json(out / MANIFEST, manifest)
        if verify is not None:
            verify()
        self._publish(task, out)
        for path in self._leftovers(task):
            shutil.rmtree(path, ignore_errors=True)

    def is_complete(self, task: Task) -> bool:
        """Whether the task's folder is there, and every file is as it was written."""
        folder = self.folder(task)
        return folder.exists() and self._damage(folder, task) is None

    def is_visible(self, task: Task, seconds: float = CACHED) -> bool:
        """Whether this machine sees the folder that another one completed, after a while at most.

        Args:
            task: the task.
            seconds: to wait at most, since a file server's client keeps old names for a while.
        """
        manifest, since = self.folder(task) / MANIFEST, time.monotonic()
        while not manifest.exists():
            if time.monotonic() - since > seconds:
                return False
            with suppress(OSError):
                os.listdir(manifest.parent.parent)  # opening a folder asks the server
            time.sleep(0.1)
        return True

    def reason_to_run(self, task: Task) -> str | None:
        """Why the task has to run, such as `missing` or `config changed: …`; None if not."""
        folder = self.folder(task)
        if not folder.exists():
            return self._why_missing(task)
        damage = self._damage(folder, task)
        return f"damaged: {damage}" if damage else None

    def timing(self, task: Task) -> dict[str, Any]:
        """The timing that `finish` wrote; empty if the file is missing or damaged."""
        try:
            timing = read_json(self.folder(task) / TIMING)
        except (OSError, ValueError):
            return {}
        return timing if isinstance(timing, dict) else {}

    def _leftovers(self, task: Task) -> list[Path]:
        """The temporary folders of all attempts at the task, the newest last."""
        found = (self.root / task.stage).glob(f".{task.key[:16]}*/")
        return sorted(found, key=_modified)

    def _publish(self, task: Task, out: Path) -> None:
        """Rename `out` to the task's folder, unless another worker has completed that one."""
        target = self.folder(task)
        if target.exists():
            if self._damage(target, task) is None:
                return
            damaged = out.with_suffix(".damaged")
            target.replace(damaged)
            shutil.rmtree(damaged, ignore_errors=True)
        try:
            out.replace(target)
        except OSError:
            if not self.is_complete(task):
                raise

    def _damage(self, folder: Path, task: Task) -> str | None:
        """The path of the first file that is not as it was written; None if all are."""
        try:
            manifest = read_json(folder / MANIFEST)
            files: dict[str, str] = manifest["files"]
            valid = manifest["key"] == task.key and manifest["settings"] == _as_json(task)
        except (OSError, ValueError, KeyError, TypeError):
            return f"{folder / MANIFEST}"
        if not valid:
            return f"{folder / MANIFEST}"
        for name, expected in files.items():
            path = folder / name
            if not path.is_file() or sha256(path) != expected:
                return f"{path}"
        return None

    def _why_missing(self, task: Task) -> str:
        """Compare with the newest folder of the same stage and label, if there is one."""
        try:
            previous = read_json(self._newest_manifests(task.stage)[task.label])
            changes = _differences(previous["settings"], _as_json(task))
        except (OSError, ValueError, KeyError, TypeError):
            return "missing"
        if changes:
            return f"config changed: {'; '.join(changes[:3])}{' …' if len(changes) > 3 else ''}"
        if modules := _changed(previous.get("source", {}), task.source):
            return f"source changed: {', '.join(modules[:3])}{' …' if len(modules) > 3 else ''}"
        inputs = [n for n, t in task.inputs.items() if previous["inputs"].get(n) != t.key]
        return f"input changed: {', '.join(inputs)}" if inputs else "missing"

    def _newest_manifests(self, stage: str) -> Mapping[str, Path]:
        """The manifest of the newest folder of each label of a stage.

        They are read again only if the folder of the stage has changed, since a large study asks
        for thousands of tasks.
        """
        folder = self.root / stage
        changed = folder.stat().st_mtime_ns
        if stage not in self._newest or self._newest[stage][0] != changed:
            self._newest[stage] = changed, _newest_manifests(folder)
        return self._newest[stage][1]


def _newest_manifests(folder: Path) -> Mapping[str, Path]:
    """The newest manifest in the folder of a stage, by label."""
    found: dict[str, tuple[float, Path]] = {}
    for path in folder.glob(f"*/{MANIFEST}"):
        try:
            label, modified = read_json(path)["label"], path.stat().st_mtime
        except (OSError, ValueError, KeyError, TypeError):
            continue
        if label not in found or modified > found[label][0]:
            found[label] = modified, path
    return {label: path for label, (_, path) in found.items()}


def _modified(path: Path) -> float:
    try:
        return path.stat().st_mtime
    except FileNotFoundError:  # another process has just removed it
        return 0.0


def _changed(old: Mapping[str, str], new: Mapping[str, str]) -> list[str]:
    """Names of the modules whose digests differ."""
    return sorted(name for name in old.keys() | new.keys() if old.get(name) != new.get(name))


def _as_json(task: Task) -> Any:
    """The settings as a manifest holds them: lists for tuples."""
    return json.loads(json.dumps(dict(task.settings)))


def _differences(old: Any, new: Any, name: str = "") -> list[str]:
    """A text such as `tune.trials 4 → 6` for each setting that differs."""
    if isinstance(old, dict) and isinstance(new, dict):
        return [
            change
            for key in sorted(old.keys() | new.keys())
            for change in _differences(old.get(key), new.get(key), f"{name}.{key}".lstrip("."))
        ]
    return [] if old == new else [f"{name} {old} → {new}"]
