"""Where results come from: settings, versions of packages, and a hash of this source."""

import json
import platform
from importlib.metadata import version
from pathlib import Path
from typing import Any

from study import __version__
from study.common.files import digest, read_json, sha256

MANIFEST = "manifest.json"
"""In the folder that a stage wrote: its settings, inputs and checksums (`study.workflow.store`)."""

SOURCE = Path(__file__).resolve().parent.parent
PACKAGES = ("torch", "lightning", "mujoco", "rerun-sdk", "optuna", "numpy")


def settings_of(folder: Path) -> dict[str, Any]:
    """The settings of the stage that wrote `folder`, from its manifest."""
    settings: dict[str, Any] = read_json(folder / MANIFEST)["settings"]
    return settings


def versions() -> dict[str, str]:
    """The versions of Python and of the packages that numbers may depend on."""
    found = {"python": platform.python_version()}
    for package in PACKAGES:
        try:
            found[package] = version(package)
        except ImportError:
            continue
    return found


def source_revision() -> str:
    """A hash of every source file of this package.

    It is the same with and without git, installed or not, and it changes with any edit.
    """
    files = {
        path.relative_to(SOURCE).as_posix(): sha256(path)
        for path in SOURCE.rglob("*")
        if path.suffix in (".py", ".c", ".h", ".xml")
    }
    return digest(files)


def made_with() -> dict[str, str]:
    """Versions and source, as properties of a recording."""
    return {
        "study_version": __version__,
        "source_revision": source_revision()[:16],
        "versions": json.dumps(versions(), sort_keys=True),
    }
