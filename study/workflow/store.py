"""Content-addressed folders: what a stage made, named by what it was made from.

A task's key is a hash of its settings and of its inputs' keys, so a changed setting names another
folder, and whatever does not depend on it keeps its own. A folder appears under its name only when
it is complete (it is renamed into place), and its manifest holds the SHA-256 of every file.
"""

import json
import shutil
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from study.common.files import digest, read_json, sha256, write_json

MANIFEST = "manifest.json"
# Wall time and the like differ from run to run: they stay out of the manifest.
TIMING = "timing.json"


@dataclass(frozen=True)
class Task:
    """One run of one stage: all that it depends on.

    Attributes:
        stage: name of the stage.
        label: what it is for, to a reader: `pusher`, `pusher/low/seed-0`, a cell's name.
        settings: JSON; the stage sees these and nothing else of the configuration.
        inputs: earlier tasks, by the name under which the stage asks for their folder.
        plugins: modules to import first. They are no part of the key.
    """

    stage: str
    label: str
    settings: Mapping[str, Any]
    inputs: Mapping[str, "Task"] = field(default_factory=dict)
    plugins: tuple[str, ...] = ()

    @cached_property
    def key(self) -> str:
        """Hash of the settings and of the inputs' keys."""
        inputs = {name: task.key for name, task in self.inputs.items()}
        return digest([self.stage, dict(self.settings), inputs])

    @property
    def name(self) -> str:
        """`train pusher/low/full_vae/seed-0`."""
        return f"{self.stage} {self.label}"

    def __hash__(self) -> int:
        return hash(self.key)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Task) and self.key == other.key


class Store:
    """The folders of all tasks, under `root`."""

    def __init__(self, root: Path) -> None:
        self.root = root

    def folder(self, task: Task) -> Path:
        """Where the task's outputs are, or will be."""
        return self.root / task.stage / task.key[:16]

    def partial(self, task: Task) -> Path:
        """Where they are while it runs."""
        return self.root / task.stage / f".{task.key[:16]}.partial"

    def log(self, task: Task) -> Path:
        """The log of the task's last run."""
        return self.root / "logs" / f"{task.stage}-{task.key[:16]}.log"

    def progress(self, task: Task) -> Path:
        """Where the task tells how far it is, while it runs."""
        return self.log(task).with_suffix(".progress")

    def forget_progress(self) -> None:
        """Remove what killed tasks told."""
        for path in (self.root / "logs").glob("*.progress"):
            path.unlink(missing_ok=True)

    def failure(self, task: Task) -> Path:
        """One line: why the task's last run failed. Not there if it did not."""
        return self.log(task).with_suffix(".error")

    def begin(self, task: Task, resumable: bool) -> Path:
        """An empty folder to write into; what a stopped run left there stays if `resumable`.

        What a failed run left is never built upon: it may be what it failed of.
        """
        out = self.partial(task)
        if out.exists() and (not resumable or self.failure(task).exists()):
            shutil.rmtree(out)
        self.failure(task).unlink(missing_ok=True)
        out.mkdir(parents=True, exist_ok=True)
        return out

    def finish(self, task: Task, timing: dict[str, Any]) -> None:
        """Complete the folder: checksums, manifest, and its name."""
        out = self.partial(task)
        files = {
            str(path.relative_to(out)): sha256(path)
            for path in sorted(out.rglob("*"))
            if path.is_file() and path.name not in (MANIFEST, TIMING)
        }
        manifest = {
            "stage": task.stage,
            "label": task.label,
            "key": task.key,
            "settings": dict(task.settings),
            "inputs": {name: source.key for name, source in task.inputs.items()},
            "files": files,
        }
        write_json(out / TIMING, timing)
        write_json(out / MANIFEST, manifest)
        target = self.folder(task)
        if target.exists():  # damaged: it was found to be so, or this task would not have run
            shutil.rmtree(target)
        out.replace(target)

    def why_not(self, task: Task) -> str | None:
        """Why the task has to run: missing, config changed, input changed, damaged. None if not."""
        folder = self.folder(task)
        if not folder.exists():
            return self._why_missing(task)
        damage = self._damage(folder, task)
        return f"damaged: {damage}" if damage else None

    def timing(self, task: Task) -> dict[str, Any]:
        """What `finish` was given, or nothing."""
        try:
            timing = read_json(self.folder(task) / TIMING)
        except (OSError, ValueError):
            return {}
        return timing if isinstance(timing, dict) else {}

    def _damage(self, folder: Path, task: Task) -> str | None:
        """The first file that is not as it was written."""
        try:
            manifest = read_json(folder / MANIFEST)
            files: dict[str, str] = manifest["files"]
            whole = manifest["key"] == task.key and manifest["settings"] == json.loads(
                json.dumps(dict(task.settings))
            )
        except (OSError, ValueError, KeyError, TypeError):
            return f"{folder / MANIFEST}"
        if not whole:
            return f"{folder / MANIFEST}"
        for name, expected in files.items():
            path = folder / name
            if not path.is_file() or sha256(path) != expected:
                return f"{path}"
        return None

    def _why_missing(self, task: Task) -> str:
        """Compare with the newest folder of the same stage and label, if there is one."""
        newest, found = -1.0, None
        for path in (self.root / task.stage).glob(f"*/{MANIFEST}"):
            try:
                manifest = read_json(path)
                if manifest["label"] == task.label and path.stat().st_mtime > newest:
                    newest, found = path.stat().st_mtime, manifest
            except (OSError, ValueError, KeyError, TypeError):
                continue
        if found is None:
            return "missing"
        changes = _differences(found["settings"], json.loads(json.dumps(dict(task.settings))))
        if changes:
            return f"config changed: {'; '.join(changes[:3])}{' …' if len(changes) > 3 else ''}"
        inputs = [n for n, t in task.inputs.items() if found["inputs"].get(n) != t.key]
        return f"input changed: {', '.join(inputs)}" if inputs else "missing"


def _differences(old: Any, new: Any, name: str = "") -> list[str]:
    """`tune.trials 4 → 6` for each setting that differs."""
    if isinstance(old, dict) and isinstance(new, dict):
        return [
            change
            for key in sorted(old.keys() | new.keys())
            for change in _differences(old.get(key), new.get(key), f"{name}.{key}".lstrip("."))
        ]
    return [] if old == new else [f"{name} {old} → {new}"]
