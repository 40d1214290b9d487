"""A network link between the scheduler and one worker of a cluster, which can be cut.

With the privileges for it, the worker is in a network namespace with an address of its own. The
link is then a pair of virtual network interfaces. Otherwise both are on the loopback interface, and
the connections of the worker to the scheduler go through a proxy.
"""

import os
import shutil
import socket
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress

LOOPBACK = "127.0.0.1"


class Link:
    """A link. Here it is never cut: the loopback interface.

    Attributes:
        host: the address at which the scheduler listens.
        prefix: begins the command of the worker.
    """

    host: str = LOOPBACK
    prefix: tuple[str, ...] = ()

    def address(self, scheduler: str) -> str:
        """Where the worker finds the scheduler with this address."""
        return scheduler

    def cut(self) -> None:
        """Lose everything that is sent. Neither side gets an error."""

    def restore(self) -> None:
        """Transport again."""

    def cut_for(self, seconds: float) -> None:
        """Cut the link for a while."""
        self.cut()
        time.sleep(seconds)
        self.restore()


class NamespaceLink(Link):
    """A link to a network namespace. `close` removes both."""

    def __init__(self) -> None:
        number = os.getpid() % 250
        self._name, self._ends = f"study-{os.getpid()}", (f"st{os.getpid()}h", f"st{os.getpid()}w")
        self.host, worker = f"10.213.{number}.1", f"10.213.{number}.2"
        self.prefix = ("ip", "netns", "exec", self._name)
        here, there = self._ends
        try:
            _ip("netns", "add", self._name)
            _ip("link", "add", here, "type", "veth", "peer", "name", there, "netns", self._name)
            _ip("address", "add", f"{self.host}/24", "dev", here)
            _ip("-n", self._name, "address", "add", f"{worker}/24", "dev", there)
            _ip("link", "set", here, "up")
            for interface in ("lo", there):
                _ip("-n", self._name, "link", "set", interface, "up")
            subprocess.run([*self.prefix, "true"], check=True, capture_output=True)
        except (OSError, subprocess.CalledProcessError):
            self.close()
            raise

    def cut(self) -> None:
        """Turn the worker's interface off."""
        _ip("-n", self._name, "link", "set", self._ends[1], "down")

    def restore(self) -> None:
        """Turn the worker's interface on."""
        _ip("-n", self._name, "link", "set", self._ends[1], "up")

    def close(self) -> None:
        """Remove the interfaces and the namespace."""
        for command in (("link", "delete", self._ends[0]), ("netns", "delete", self._name)):
            with suppress(OSError, subprocess.CalledProcessError):
                _ip(*command)


class ProxyLink(Link):
    """A proxy before the scheduler, which may stop to transport."""

    def __init__(self) -> None:
        self._listener = socket.create_server((LOOPBACK, 0))
        self._scheduler = 0
        self._is_open = threading.Event()
        self._is_open.set()
        threading.Thread(target=self._accept, daemon=True).start()

    def address(self, scheduler: str) -> str:
        """That of the proxy."""
        self._scheduler = int(scheduler.rpartition(":")[2])
        return f"tcp://{LOOPBACK}:{self._listener.getsockname()[1]}"

    def cut(self) -> None:
        """Transport nothing. What arrives meanwhile is sent later, as TCP would do."""
        self._is_open.clear()

    def restore(self) -> None:
        """Transport again."""
        self._is_open.set()

    def close(self) -> None:
        """Accept no more connections."""
        self._listener.close()

    def _accept(self) -> None:
        with suppress(OSError):  # it was closed
            while True:
                near, _ = self._listener.accept()
                try:
                    far = socket.create_connection((LOOPBACK, self._scheduler))
                except OSError:
                    near.close()
                    continue
                for pair in ((near, far), (far, near)):
                    threading.Thread(target=self._transport, args=pair, daemon=True).start()

    def _transport(self, source: socket.socket, target: socket.socket) -> None:
        with suppress(OSError):
            while data := source.recv(2**16):
                self._is_open.wait()
                target.sendall(data)
        for end in (source, target):
            with suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)


@contextmanager
def link() -> Iterator[Link]:
    """A link that can be cut, of the kind for which this process has the privileges."""
    new_link: NamespaceLink | ProxyLink
    try:
        if shutil.which("ip") is None or os.getuid() != 0:
            raise OSError
        new_link = NamespaceLink()
    except (OSError, subprocess.CalledProcessError):
        new_link = ProxyLink()
    try:
        yield new_link
    finally:
        new_link.close()


def _ip(*arguments: str) -> None:
    subprocess.run(["ip", *arguments], check=True, capture_output=True)
