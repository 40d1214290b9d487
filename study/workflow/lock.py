"""Lock a results folder, so that one run at a time writes into it.

There are two parts. A lock of the operating system excludes a second run on the same machine, and
is free at once when its process ends or is killed. A file server need not pass such a lock on to
other machines. Among machines a lease excludes a second run (`study.workflow.lease`): the file
``.lock.json``, which also says who holds the folder.

The lock is that of the main process, which starts stages and publishes results. Stages have leases
of their own, since workers of a cluster may outlive the main process.
"""

import errno
import fcntl
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from filelock import FileLock, Timeout

from study.common.errors import BadInput, StudyError
from study.workflow.lease import (
    Lease,
    LeaseInUse,
    LeaseLost,
    Terms,
    Watch,
    read_holder,
    remove_abandoned,
    running_system,
)

LEASE = ".lock.json"
"""The file of the lease of a folder."""
LONGEST_WAIT = 0.2
"""Seconds to wait for a lock that `is_locked` may hold."""
TERMS = Terms(seconds=60.0)
"""Of the lease of a folder."""
NO_LOCKS = (errno.ENOLCK, errno.ENOSYS, errno.ENOTSUP)
"""Errors of file systems that have no locks."""


class Lock:
    """The lock of a results folder, as `locked` yields it."""

    def __init__(self, folder: Path, lease: Lease) -> None:
        self._folder, self._lease = folder, lease

    def verify(self) -> None:
        """Check that no other machine has taken the folder over, before results are written.

        Raises:
            StudyError: this process was stopped for so long that another one has the folder.
        """
        try:
            self._lease.verify()
        except LeaseLost:
            raise StudyError(
                f"--out: {self._folder} was taken over by {_describe(self._folder)}, since this "
                "run was stopped for more than a minute; results are not written"
            ) from None


@contextmanager
def locked(folder: Path, terms: Terms = TERMS) -> Iterator[Lock]:
    """Lock `folder`.

    Args:
        folder: a results folder.
        terms: of the lease. A run on another machine that was lost holds the folder so long.

    Raises:
        BadInput: another run holds the lock; the error names the process.
    """
    lock = FileLock(folder / ".lock")
    try:
        lock.acquire(timeout=LONGEST_WAIT)
    except Timeout:
        raise _in_use(folder) from None
    except NotImplementedError:
        pass  # the file system has no locks
    except OSError as error:
        if error.errno not in NO_LOCKS:
            raise
    lease = Lease(folder / LEASE, terms)
    try:
        lease.take()
    except LeaseInUse:
        lock.release()
        raise _in_use(folder) from None
    try:
        remove_abandoned(folder, LEASE)
        yield Lock(folder, lease)
    finally:
        lease.release()
        lock.release()


def is_locked(folder: Path, watch: Watch | None = None) -> bool:
    """Whether a run holds the folder, as far as this machine knows. Nothing is written.

    Args:
        folder: a results folder.
        watch: from `watch`, since when the folder is observed. Without it, a run whose machine was
            lost counts until the next run takes the folder over.
    """
    try:
        with (folder / ".lock").open("rb") as file:
            # A shared lock needs no permission to write. It is held for microseconds, and `locked`
            # waits that long.
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:  # there is no lock, or the file cannot be opened
        pass
    holder = read_holder(folder / LEASE)
    is_elsewhere = holder is not None and holder.system != running_system()
    return is_elsewhere and not (watch is not None and watch.has_expired())


def watch(folder: Path) -> Watch:
    """Observe from now on whether the run that holds a folder lives."""
    return Watch(folder / LEASE)


def _in_use(folder: Path) -> BadInput:
    return BadInput(f"--out: {folder} is in use by {_describe(folder)}; wait, or use another --out")


def _describe(folder: Path) -> str:
    try:
        return str(read_holder(folder / LEASE) or "another run")
    except OSError:
        return "another run"
