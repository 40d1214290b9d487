"""One run at a time on a results folder. A second run is told who holds the folder."""

import json
import os
import socket
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path

from filelock import FileLock, Timeout

from study.common.errors import BadInput


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Lock `folder`. The operating system releases the lock when the process ends, however it ends.

    Raises:
        BadInput: another run holds it.
    """
    holder = folder / ".lock.json"
    lock = FileLock(folder / ".lock")
    try:
        lock.acquire(timeout=0)
    except Timeout:
        raise BadInput(
            f"--out: {folder} is in use by {_describe(holder)}; wait, or use another --out"
        ) from None
    try:
        holder.write_text(
            json.dumps(
                {
                    "process": os.getpid(),
                    "machine": socket.gethostname(),
                    "since": datetime.now().astimezone().isoformat(timespec="seconds"),
                    "command": " ".join(sys.argv[1:]),
                }
            )
        )
        yield
    finally:
        holder.unlink(missing_ok=True)
        lock.release()


def is_locked(folder: Path) -> bool:
    """Whether a run holds the folder."""
    if not (folder / ".lock").exists():
        return False
    try:
        with FileLock(folder / ".lock").acquire(timeout=0):
            return False
    except Timeout:
        return True


def _describe(holder: Path) -> str:
    try:
        facts = json.loads(holder.read_text())
        return "process {process} on {machine} since {since} ('{command}')".format(**facts)
    except (OSError, ValueError, KeyError, TypeError):
        return "another run"
