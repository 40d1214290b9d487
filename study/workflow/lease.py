"""Leases: a small file says which process computes a stage, and that this process is still alive.

The holder renews its lease by changing the modification time of the file. A lease that is not
renewed for its duration is expired, and another process may take it over. A process that was
stopped and continues finds the name of the new holder in the file, and ends its stage.

The lease relies on guarantees of NFS: `link` and `rename` are atomic, and opening a file reads
its current attributes from the server (close-to-open consistency). No lock of the operating system
is used. Clocks of different machines are not compared: a process that waits measures with its own
monotonic clock how long the file stays as it is.

A lease avoids duplicate work. It does not guarantee mutual exclusion. Each holder writes into a
folder with its own token in the name (`study.workflow.store`), and a complete folder is never
replaced. So two holders at the same time do the work twice and mix no files. A race between two
takeovers allows them, and so does a file system without hard links.
"""

import errno
import json
import os
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from datetime import datetime
from functools import cache
from pathlib import Path
from secrets import token_hex

from study.common.secrets import without_passwords

RENEWALS = 5
"""Renewals of a lease in its duration."""
LONGEST_PAUSE = 1.0
"""Seconds between two polls of a lease that another process holds, at most."""
TOKEN = 6
"""Bytes of the token of a holder."""
NO_HARD_LINKS = {errno.EPERM, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS, errno.EMLINK}
"""Errors of a file system without hard links."""


class LeaseLost(Exception):
    """Another process has taken over the lease, since this one did not renew it in time."""


class LeaseInUse(Exception):
    """Another process renews the lease."""

    def __init__(self, holder: "Holder") -> None:
        super().__init__(str(holder))
        self.holder = holder


@dataclass(frozen=True)
class Terms:
    """The terms of a lease.

    Attributes:
        seconds: duration without a renewal.
        retries: how often a stage is tried again within a run, after its worker was lost.
        run: identifies the run. Attempts of other runs do not count.
    """

    seconds: float = 60.0
    retries: int = 3
    run: str = ""


USUAL = Terms()
"""The terms without settings."""


@dataclass(frozen=True)
class Holder:
    """The process that holds a lease, as the file states it.

    Attributes:
        token: identifies this holder.
        host: name of the machine.
        system: identifies the running system of the machine: after a restart it is another one.
        process: number of the process.
        since: when the process took the lease, in ISO format.
        seconds: duration of the lease without a renewal.
        run: of `Terms`.
        attempt: 1, and one more for each holder of the same run that was lost.
        command: arguments of the process.
    """

    token: str
    host: str
    system: str
    process: int
    since: str
    seconds: float
    run: str
    attempt: int
    command: str

    def __str__(self) -> str:
        return f"process {self.process} on {self.host} since {self.since} ('{self.command}')"

    @property
    def has_ended(self) -> bool:
        """Whether it is a process of this system that has ended; False if that is unknown."""
        if self.system != running_system():
            return False
        try:
            os.kill(self.process, 0)
        except ProcessLookupError:
            return True
        except OSError:
            return False
        return False


@cache
def running_system() -> str:
    """Identifies this machine since it was started, and the container of this process."""
    parts = [socket.gethostname()]
    with suppress(OSError):
        parts.append(Path("/proc/sys/kernel/random/boot_id").read_text(encoding="utf-8").strip())
        parts.append(str(os.stat("/proc/self/ns/pid").st_ino))
    return " ".join(parts)


def read_holder(path: Path) -> Holder | None:
    """The holder that a lease file names; None if there is no lease, or the file is damaged."""
    content = _observe(path)
    return None if content is None else _parse(content[0])


class Lease:
    """A lease that this process takes, renews from a thread, and releases.

    Args:
        path: the file.
        terms: duration, and the run.
    """

    def __init__(self, path: Path, terms: Terms) -> None:
        self.path, self.terms = path, terms
        self.token, self.attempt = token_hex(TOKEN), 1
        self._is_lost = False
        self._verified = 0.0
        self._ended = threading.Event()
        self._thread: threading.Thread | None = None

    def take(self, waits: Callable[[Holder], None] | None = None) -> None:
        """Take the lease, as soon as no other process holds it.

        Args:
            waits: called once with the other holder. None does not wait for a holder that lives.

        Raises:
            LeaseInUse: another process renews the lease, and `waits` is None.
        """
        self.path.parent.mkdir(parents=True, exist_ok=True)
        observed, since, has_waited = _observe(self.path), time.monotonic(), False
        while True:
            holder = None if observed is None else _parse(observed[0])
            if holder is None or holder.has_ended or time.monotonic() - since > holder.seconds:
                self.attempt = self._attempt_after(holder)
                if self._write(replaces=observed is not None):
                    break
            else:
                if waits is not None and not has_waited:
                    has_waited = True
                    waits(holder)
                time.sleep(min(holder.seconds / RENEWALS / 2, LONGEST_PAUSE))
            current = _observe(self.path)
            if current != observed:
                if current is not None and holder is not None and waits is None:
                    raise LeaseInUse(_parse(current[0]) or holder)
                observed, since = current, time.monotonic()
        self._verified = time.monotonic()
        self._thread = threading.Thread(target=self._keep, name="lease", daemon=True)
        self._thread.start()

    def check(self) -> None:
        """Check that this process still holds the lease; reads the file if it is due.

        Raises:
            LeaseLost: another process holds it.
        """
        if time.monotonic() - self._verified > self.terms.seconds / RENEWALS:
            with suppress(OSError):  # the file server may be away; `verify` comes before the end
                self.verify()
        elif self._is_lost:
            raise LeaseLost(self._lost())

    def verify(self) -> None:
        """Read the file, and renew the lease.

        Raises:
            LeaseLost: another process holds it.
        """
        if not self._is_lost:
            self._renew()
        if self._is_lost:
            raise LeaseLost(self._lost())

    def release(self) -> None:
        """Stop renewing, and remove the file if it is this process's."""
        self._ended.set()
        if self._thread is not None:
            self._thread.join()
        with suppress(OSError):
            if self._is_mine():
                self.path.unlink()

    def _attempt_after(self, holder: Holder | None) -> int:
        """The number of this attempt in its run, after that of a holder that was lost."""
        is_of_run = holder is not None and holder.run == self.terms.run != ""
        return holder.attempt + 1 if holder is not None and is_of_run else 1

    def _keep(self) -> None:
        while not self._is_lost and not self._ended.wait(self.terms.seconds / RENEWALS):
            with suppress(OSError):  # the file server may be away for a while
                self._renew()

    def _renew(self) -> None:
        """Change the modification time of the file. It is that of the opened file, so a lease that
        another process puts into its place at this moment stays untouched."""
        try:
            with self.path.open("rb") as file:
                holder = _parse(file.read())
                if holder is not None and holder.token == self.token:
                    os.utime(file.fileno())
                    self._verified = time.monotonic()
                else:
                    self._is_lost = True
        except FileNotFoundError:  # another process has held it, and completed its work
            self._is_lost = True

    def _write(self, replaces: bool) -> bool:
        """Put a file of this holder into place; returns whether it is there."""
        new = self.path.with_name(f".{self.path.name.lstrip('.')}.{self.token}")
        try:
            with new.open("w", encoding="utf-8") as file:
                json.dump(asdict(self._holder()), file, indent=1)
                file.flush()
                os.fsync(file.fileno())
            if not replaces:
                try:
                    os.link(new, self.path)
                except (FileExistsError, FileNotFoundError):
                    pass  # another process was faster, or the reply of the file server was lost
                except OSError as error:
                    if error.errno not in NO_HARD_LINKS:
                        raise
                    replaces = not self.path.exists()
            if replaces:
                with suppress(FileNotFoundError):  # a reply was lost, and `_is_mine` decides
                    new.replace(self.path)
        finally:
            new.unlink(missing_ok=True)
        return self._is_mine()

    def _is_mine(self) -> bool:
        holder = read_holder(self.path)
        return holder is not None and holder.token == self.token

    def _holder(self) -> Holder:
        return Holder(
            token=self.token,
            host=socket.gethostname(),
            system=running_system(),
            process=os.getpid(),
            since=datetime.now().astimezone().isoformat(timespec="seconds"),
            seconds=self.terms.seconds,
            run=self.terms.run,
            attempt=self.attempt,
            command=without_passwords(" ".join(sys.argv[1:])),
        )

    def _lost(self) -> str:
        return f"lease {self.path} was lost to {read_holder(self.path) or 'another process'}"


class Watch:
    """Watches a lease without taking it. The machine of its holder may be lost.

    Args:
        path: the file.
    """

    def __init__(self, path: Path) -> None:
        self._path, self._observed, self._since = path, _observe(path), time.monotonic()

    def has_expired(self) -> bool:
        """Whether there is no lease, or its holder has not renewed it for its duration."""
        current = _observe(self._path)
        if current != self._observed:
            self._observed, self._since = current, time.monotonic()
        holder = None if current is None else _parse(current[0])
        return holder is None or time.monotonic() - self._since > holder.seconds


def remove_abandoned(folder: Path, name: str) -> None:
    """Remove the temporary files of processes that were killed as they took a lease in a folder.

    A living process has such a file for milliseconds, and tries again if the file is removed.

    Args:
        folder: of the leases.
        name: that of their files, with wildcards.
    """
    for path in folder.glob(f"{name}.{'[0-9a-f]' * TOKEN * 2}"):
        path.unlink(missing_ok=True)


@contextmanager
def hold(
    path: Path, terms: Terms, waits: Callable[[Holder], None] | None = None
) -> Iterator[Lease]:
    """Hold the lease in the file `path`. See `Lease.take`.

    Raises:
        LeaseInUse: another process renews the lease, and `waits` is None.
    """
    lease = Lease(path, terms)
    lease.take(waits)
    try:
        yield lease
    finally:
        lease.release()


def _observe(path: Path) -> tuple[bytes, int] | None:
    """The content and the modification time of a lease; None if there is none."""
    try:
        with path.open("rb") as file:
            return file.read(), os.fstat(file.fileno()).st_mtime_ns
    except OSError as error:
        if error.errno in (errno.ENOENT, errno.ESTALE):  # ESTALE: replaced on a file server
            return None
        raise


def _parse(content: bytes) -> Holder | None:
    try:
        holder = Holder(**json.loads(content))
        is_valid = holder.seconds > 0 and holder.attempt > 0 and holder.process > 0
    except (ValueError, TypeError):
        return None
    return holder if is_valid else None
