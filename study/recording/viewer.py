"""The Rerun viewer, in a window or without a window for screenshots."""

import os
import platform
import socket
import subprocess
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, TypeVar

from rerun.experimental import ViewerClient

from study.common.errors import StudyError
from study.recording.integrity import check

T = TypeVar("T")

_PATIENCE = 60.0
"""Seconds to wait for an answer of the viewer."""
_STARTING = 2.0
"""Seconds after the start at which a running viewer has opened its window."""
LOCALHOST = "127.0.0.1"
WITHOUT_DISPLAY = "without one, --save writes to files"
"""How the commands that open the viewer work without a display."""
_NO_DRIVER = (
    "no Vulkan driver: the viewer cannot draw without one "
    "(on Debian or Ubuntu: apt-get install mesa-vulkan-drivers)"
)
_DRIVER_FOLDERS = (
    "/usr/share/vulkan/icd.d",
    "/usr/local/share/vulkan/icd.d",
    "/etc/vulkan/icd.d",
    "~/.local/share/vulkan/icd.d",
)


def open_viewer(paths: Sequence[Path]) -> None:
    """Open recordings in the Rerun viewer, in a window that stays when this process ends.

    Raises:
        StudyError: a recording is missing or damaged, there is no display, or the viewer does not
            start.
    """
    for path in paths:
        check(path)
    check_display()
    # By default the viewer accepts connections from the network. A second viewer sends its
    # recordings to the first one, which may be another user's.
    command = [executable(), "--bind", LOCALHOST, "--port", "auto", *map(str, paths)]
    with TemporaryFile() as log:
        process = subprocess.Popen(
            command,
            start_new_session=True,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=log,
        )
        try:
            code = process.wait(_STARTING)
        except subprocess.TimeoutExpired:  # its window is open
            return
        if code:
            raise StudyError(f"the viewer does not start: {_reason(code, log)}; {WITHOUT_DISPLAY}")


def check_display() -> None:
    """Check that a window can be opened. Other systems than Linux always have a display.

    Raises:
        StudyError: there is no display.
    """
    names = ("WAYLAND_DISPLAY", "WAYLAND_SOCKET", "DISPLAY")
    if platform.system() == "Linux" and not any(os.environ.get(name) for name in names):
        raise StudyError(f"there is no display to open a window on; {WITHOUT_DISPLAY}")


def has_driver() -> bool:
    """Whether a Vulkan driver is installed. Only on Linux it may be missing."""
    if platform.system() != "Linux":
        return True
    if any(os.environ.get(name) for name in ("VK_ICD_FILENAMES", "VK_DRIVER_FILES")):
        return True
    return any(any(Path(f).expanduser().glob("*.json")) for f in _DRIVER_FOLDERS)


@contextmanager
def headless(width: int = 1920, height: int = 1080) -> Iterator[ViewerClient]:
    """A viewer without a window, `width` × `height` pixels, for a `with` block.

    Raises:
        StudyError: there is no Vulkan driver, or the viewer does not start.
    """
    if not has_driver():
        raise StudyError(_NO_DRIVER)
    with socket.socket() as probe:
        probe.bind((LOCALHOST, 0))
        port = probe.getsockname()[1]
    # `ViewerClient.spawn` would start a viewer that accepts connections from the network.
    command = [executable(), "--headless", "--bind", LOCALHOST, "--port", str(port)]
    command += ["--window-size", f"{width}x{height}"]
    with TemporaryFile() as log:
        process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=log, stderr=subprocess.STDOUT
        )
        try:
            yield ask(partial(_connect, port, process, log))
        finally:
            process.terminate()
            try:
                process.wait(_PATIENCE)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def ask(question: Callable[[], T]) -> T:
    """Ask the viewer until it answers, and return the answer.

    Raises:
        StudyError: the viewer has not answered for a minute.
    """
    end = time.monotonic() + _PATIENCE
    while True:
        try:
            return question()
        except ConnectionError as error:
            if time.monotonic() > end:
                raise StudyError(f"the viewer does not answer: {_first_line(error)}") from error
            time.sleep(0.25)


def wait_for(question: Callable[[], T], condition: Callable[[T], bool]) -> T:
    """The first answer that meets a condition.

    Raises:
        StudyError: no answer has met the condition for a minute.
    """
    end = time.monotonic() + _PATIENCE
    while not condition(answer := ask(question)):
        if time.monotonic() > end:
            raise StudyError("the viewer has not loaded the recording for a minute: try again")
        time.sleep(0.1)
    return answer


def _connect(port: int, process: subprocess.Popen[bytes], log: IO[bytes]) -> ViewerClient:
    """A connection to a viewer that answers.

    Raises:
        ConnectionError: the viewer does not answer yet.
        StudyError: the viewer has ended; the message has the last line of its log.
    """
    if process.poll() is not None:
        raise StudyError(f"the viewer does not start: {_reason(process.returncode, log)}")
    client = ViewerClient.connect(f"rerun+http://{LOCALHOST}:{port}/proxy")
    client.get_state()
    return client


def _reason(code: int, log: IO[bytes]) -> str:
    """The reason why a viewer has ended: the last line of its log, or its exit code."""
    log.seek(0)
    lines = log.read().decode(errors="replace").strip().splitlines()
    return lines[-1].strip() if lines else f"exit code {code}"


def executable() -> str:
    """The viewer of the package rerun-sdk, which need not be on the PATH."""
    package = find_spec("rerun_cli")
    if package is None or package.origin is None:
        raise StudyError("the Rerun viewer is missing: pip install rerun-sdk")
    binary = Path(package.origin).with_name("rerun.exe" if os.name == "nt" else "rerun")
    if not binary.is_file():
        raise StudyError(f"the Rerun viewer is missing: {binary}; pip install rerun-sdk")
    return str(binary)


def _first_line(error: Exception) -> str:
    return str(error).splitlines()[0] if str(error) else type(error).__name__
