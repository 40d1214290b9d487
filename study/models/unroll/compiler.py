"""Compile a C source to a shared library for this processor, and cache the library."""

import atexit
import hashlib
import os
import platform
import shutil
import subprocess
import tempfile
from pathlib import Path

from study.common.files import read_checksums, sha256, write_checksums

FLAGS = ("-O3", "-march=native", "-fPIC", "-shared")
SWITCH = "STUDY_COMPILED"
"""Environment variable. The value 0 turns compilation off."""


def find() -> str | None:
    """Path of the C compiler: the first of $CC, cc, gcc and clang that exists.

    Returns:
        None if there is none, or if the environment variable `SWITCH` forbids its use.
    """
    if os.environ.get(SWITCH) == "0":
        return None
    names = (os.environ.get("CC", ""), "cc", "gcc", "clang")
    return next((path for name in names if name and (path := shutil.which(name))), None)


def build(source: Path, *headers: Path, compiler: str) -> Path:
    """Compile a source, unless the cache has its shared library.

    A damaged library would end the process when it is loaded. So the cache has a checksum beside
    each library, and a library that differs from it is compiled again.

    The cache is ``study`` in the user's cache folder. If that folder is read-only, the library is
    compiled into a temporary folder for this process alone.

    Args:
        source: the C file.
        headers: files of the study that it includes.
        compiler: path of the compiler.

    Returns:
        path of the shared library.

    Raises:
        OSError: the compiler cannot be run, or it reports an error.
    """
    version = _run([compiler, "--version"])
    texts = [file.read_text(encoding="utf-8") for file in (source, *headers)]
    parts = (*texts, version, _processor(), *FLAGS)
    key = hashlib.sha256("\0".join(parts).encode()).hexdigest()[:20]
    folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "study"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        scratch = Path(tempfile.mkdtemp(dir=folder))
    except OSError:
        folder = scratch = Path(tempfile.mkdtemp(prefix="study-"))
        atexit.register(shutil.rmtree, folder, ignore_errors=True)
    path = folder / f"{source.stem}-{key}.so"
    try:
        if not _is_intact(path):
            # Several processes may compile at once. So each writes a separate file and moves it.
            _run([compiler, *FLAGS, str(source), "-o", str(scratch / path.name)])
            checksums = {path.name: sha256(scratch / path.name)}
            os.replace(scratch / path.name, path)
            write_checksums(_checksum(path), checksums)
    finally:
        if scratch != folder:
            shutil.rmtree(scratch, ignore_errors=True)
    return path


def _checksum(library: Path) -> Path:
    """The file with the SHA-256 of a library in the cache."""
    return library.with_name(f"{library.name}.sha256")


def _is_intact(library: Path) -> bool:
    """Whether the cache has a library, as it was compiled."""
    try:
        return read_checksums(_checksum(library))[library.name] == sha256(library)
    except (OSError, ValueError, KeyError):
        return False


def _run(command: list[str]) -> str:
    """The standard output of a command, in English."""
    try:
        process = subprocess.run(
            command,
            capture_output=True,
            timeout=120,
            encoding="utf-8",
            errors="replace",
            env=os.environ | {"LC_ALL": "C"},
        )
    except subprocess.SubprocessError as error:
        raise OSError(str(error)) from None
    if process.returncode:
        raise OSError(f"{command[0]} failed: {' '.join(process.stderr.split())[:200]}")
    return process.stdout


def _processor() -> str:
    """A description of the processor, since ``-march=native`` depends on it."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return f"{platform.machine()} {platform.processor()}"
    keys = ("model name", "flags", "Features", "CPU part")
    return "\n".join(sorted({line for line in lines if line.startswith(keys)}))
