"""C source to a shared library for the processor at hand, made once and kept for the next time."""

import hashlib
import os
import platform
import shutil
import subprocess
import tempfile
from pathlib import Path

FLAGS = ("-O3", "-march=native", "-fPIC", "-shared")
SWITCH = "STUDY_COMPILED"
"""With 0 in this environment variable nothing is compiled."""


def find() -> str | None:
    """The C compiler: $CC, cc, gcc or clang; None if there is none, or none is to be used."""
    if os.environ.get(SWITCH) == "0":
        return None
    names = (os.environ.get("CC", ""), "cc", "gcc", "clang")
    return next((path for name in names if name and (path := shutil.which(name))), None)


def build(source: Path, compiler: str) -> Path:
    """The shared library of a source, in the user's cache folder; compiled if it is not there.

    Where that folder cannot be written, the library is compiled for this process alone.

    Raises:
        OSError: the compiler cannot be run, or fails.
    """
    version = _run([compiler, "--version"])
    parts = (source.read_text(encoding="utf-8"), version, _processor(), *FLAGS)
    key = hashlib.sha256("\0".join(parts).encode()).hexdigest()[:20]
    folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "study"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        own = Path(tempfile.mkdtemp(dir=folder))
    except OSError:
        folder = own = Path(tempfile.mkdtemp(prefix="study-"))
    path = folder / f"{source.stem}-{key}.so"
    try:
        if not path.is_file():
            # Several processes may compile at once: each its own file, and the last one stays.
            _run([compiler, *FLAGS, str(source), "-o", str(own / path.name)])
            os.replace(own / path.name, path)
    finally:
        if own != folder:
            shutil.rmtree(own, ignore_errors=True)
    return path


def _run(command: list[str]) -> str:
    try:
        done = subprocess.run(command, capture_output=True, timeout=120, text=True)
    except subprocess.SubprocessError as error:
        raise OSError(str(error)) from None
    if done.returncode:
        raise OSError(f"{command[0]} failed: {' '.join(done.stderr.split())[:200]}")
    return done.stdout


def _processor() -> str:
    """What a program for this very processor depends on."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return f"{platform.machine()} {platform.processor()}"
    wanted = ("model name", "flags", "Features", "CPU part")
    return "\n".join(sorted({line for line in lines if line.startswith(wanted)}))
