"""Lock a results folder, so that one run at a time writes into it."""

import fcntl
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
from study.common.secrets import without_passwords

LONGEST_WAIT = 0.2
"""Seconds to wait for a lock that `is_locked` may hold."""


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Lock `folder`. The operating system releases the lock when the process ends or is killed.

    Raises:
        BadInput: another run holds the lock; the error names the process.
    """
    holder = folder / ".lock.json"
    lock = FileLock(folder / ".lock")
    try:
        lock.acquire(timeout=LONGEST_WAIT)
    except Timeout:
        raise BadInput(
            f"--out: {folder} is in use by {_describe(holder)}; wait, or use another --out"
        ) from None
    try:
        facts = {
            "process": os.getpid(),
            "machine": socket.gethostname(),
            "since": datetime.now().astimezone().isoformat(timespec="seconds"),
            "command": without_passwords(" ".join(sys.argv[1:])),
        }
        holder.write_text(json.dumps(facts), encoding="utf-8")
        yield
    finally:
        holder.unlink(missing_ok=True)
        lock.release()


def is_locked(folder: Path) -> bool:
    """Whether a run holds the folder. Nothing is written."""
    try:
        with (folder / ".lock").open("rb") as file:
            # A shared lock needs no permission to write. It is held for microseconds, and `locked`
            # waits that long.
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:  # there is no lock, or the file cannot be opened
        return False
    return False


def _describe(holder: Path) -> str:
    try:
        facts = json.loads(holder.read_text(encoding="utf-8"))
        return "process {process} on {machine} since {since} ('{command}')".format(**facts)
    except (OSError, ValueError, KeyError, TypeError):
        return "another run"
