"""What results were made with: the versions of packages, and the revision of this source."""

import json
import platform
from importlib.metadata import version
from pathlib import Path

from study import __version__
from study.common.files import digest, sha256

SOURCE = Path(__file__).resolve().parent.parent
PACKAGES = ("torch", "lightning", "mujoco", "rerun-sdk", "optuna", "numpy")


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
    """A hash of every source file of this package: the same with and without git, installed or not.

    It changes with any edit, committed or not, so it names the source more surely than a commit.
    """
    files = {
        path.relative_to(SOURCE).as_posix(): sha256(path)
        for path in SOURCE.rglob("*")
        if path.suffix in (".py", ".c", ".xml")
    }
    return digest(files)


def made_with() -> dict[str, str]:
    """The same for the properties of a recording."""
    return {
        "study_version": __version__,
        "source_revision": source_revision()[:16],
        "versions": json.dumps(versions(), sort_keys=True),
    }
