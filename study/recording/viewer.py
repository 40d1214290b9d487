"""The Rerun viewer: on the screen, and without one, for screenshots."""

import os
import re
import socket
import subprocess
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, Any, TypeVar

from rerun.experimental import ViewerClient

from study.common.errors import StudyError
from study.recording.integrity import check

T = TypeVar("T")

_PATIENCE = 60.0
_HERE = "127.0.0.1"
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


@dataclass(frozen=True)
class Screenshots:
    """What the viewer showed.

    Attributes:
        views: the PNG of each view, by name; views of one name are numbered.
        pages: the PNG of the whole window for each page (each choice of tabs).
        problems: errors in the viewer's log, and what views report that they could not draw.
    """

    views: dict[str, Path]
    pages: list[Path]
    problems: list[str]


def open_viewer(paths: Sequence[Path]) -> None:
    """Open recordings in the Rerun viewer, in a window that outlives this process.

    Raises:
        StudyError: a recording is missing or damaged.
    """
    for path in paths:
        check(path)
    subprocess.Popen(
        [_executable(), *map(str, paths)], start_new_session=True, stdin=subprocess.DEVNULL
    )


def has_driver() -> bool:
    """Whether some Vulkan driver is installed (Linux; elsewhere the system brings one)."""
    if os.name != "posix" or os.uname().sysname != "Linux":
        return True
    if any(os.environ.get(name) for name in ("VK_ICD_FILENAMES", "VK_DRIVER_FILES")):
        return True
    return any(any(Path(f).expanduser().glob("*.json")) for f in _DRIVER_FOLDERS)


def screenshots(path: Path, out_dir: Path) -> Screenshots:
    """Draw every view of a recording, hidden tabs too, in the real viewer with no screen.

    Raises:
        StudyError: there is no Vulkan driver, the recording is missing or damaged, or the viewer
            does not answer.
    """
    check(path)
    out_dir.mkdir(parents=True, exist_ok=True)
    with _headless() as client:
        client.open(str(Path(path).resolve()))
        state = _wait(client.get_state, lambda s: not s.loading and bool(s.views))
        recording = state.recordings[0]
        timelines = {line.name: line for line in recording.timelines}
        design = _ask(client.get_blueprint).blueprint
        chosen = design.get("/time_panel", {}).get("TimePanelBlueprint", {}).get("timeline")
        end = timelines[chosen].end if chosen in timelines else None
        if end is not None:
            # Two thirds of the way: whatever moves has moved, and has not yet arrived.
            start = timelines[chosen].start or 0
            at = start + 2 * (end - start) // 3
            _ask(lambda: client.set_time(chosen, sequence=at, play_state="paused"))
        views: dict[str, Path] = {}
        pages: list[Path] = []
        problems: list[str] = []
        names = {view.view_id.replace("-", ""): view.name for view in state.views}
        for page, (tabs, shown) in enumerate(_pages(design)):
            for container, tab in tabs.items():
                design[container]["ContainerBlueprint"]["active_tab"] = tab
            if tabs:
                _ask(lambda: client.set_blueprint(design, "recording"))
            whole = out_dir / f"{path.stem}-page-{page + 1:02d}.png"
            whole.write_bytes(_settled(client))
            pages.append(whole)
            for view in shown:
                name = _free(names[_view_id(view)], views)
                file = out_dir / f"{path.stem}-{len(views) + 1:03d}-{_slug(name)}.png"
                identity = view.removeprefix("/view/")
                file.write_bytes(_ask(partial(client.take_screenshot, identity)))
                views[name] = file
            problems += [
                f"{view.name}: {report.summary}"
                for view in _ask(client.get_state).views
                for report in view.reports
            ]
        problems += [
            f"{e.target}: {e.message}" for e in _ask(client.get_logs) if e.level == "ERROR"
        ]
    return Screenshots(views, pages, problems)


@contextmanager
def _headless() -> Iterator[ViewerClient]:
    """A viewer without a window, for as long as the block lasts.

    Not by way of `ViewerClient.spawn`, whose viewer listens to the whole network.
    """
    if not has_driver():
        raise StudyError(_NO_DRIVER)
    with socket.socket() as free:
        free.bind((_HERE, 0))
        port = free.getsockname()[1]
    command = [_executable(), "--headless", "--bind", _HERE, "--port", str(port)]
    with TemporaryFile() as log:
        process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=log, stderr=subprocess.STDOUT
        )
        try:
            yield _ask(partial(_connect, port, process, log))
        finally:
            process.terminate()
            try:
                process.wait(_PATIENCE)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def _connect(port: int, process: subprocess.Popen[bytes], log: IO[bytes]) -> ViewerClient:
    """A connection to a viewer that answers.

    Raises:
        ConnectionError: it does not answer yet.
        StudyError: it has ended; with the last line of its log.
    """
    if process.poll() is not None:
        log.seek(0)
        lines = log.read().decode(errors="replace").strip().splitlines()
        reason = lines[-1] if lines else f"exit code {process.returncode}"
        raise StudyError(f"the viewer does not start: {reason}")
    client = ViewerClient.connect(f"rerun+http://{_HERE}:{port}/proxy")
    client.get_state()
    return client


def _executable() -> str:
    """The viewer that came with rerun-sdk, which need not be on the PATH."""
    package = find_spec("rerun_cli")
    if package is None or package.origin is None:
        raise StudyError("the Rerun viewer is missing: install rerun-sdk")
    binary = Path(package.origin).with_name("rerun.exe" if os.name == "nt" else "rerun")
    if not binary.is_file():
        raise StudyError(f"the Rerun viewer is missing: {binary}")
    return str(binary)


def _ask(question: Callable[[], T]) -> T:
    """Ask the viewer, which now and then does not answer, until it does."""
    end = time.monotonic() + _PATIENCE
    while True:
        try:
            return question()
        except ConnectionError as error:
            if time.monotonic() > end:
                raise StudyError(f"the viewer does not answer: {_first_line(error)}") from error
            time.sleep(0.25)


def _wait(question: Callable[[], T], done: Callable[[T], bool]) -> T:
    """Ask until the answer is what is waited for."""
    end = time.monotonic() + _PATIENCE
    while not done(answer := _ask(question)):
        if time.monotonic() > end:
            raise StudyError("the viewer has not loaded the recording in a minute")
        time.sleep(0.1)
    return answer


def _settled(client: ViewerClient) -> bytes:
    """The window, once two pictures of it are the same: plots of a new tab are drawn a frame late.

    Of a window that never comes to rest, the tenth picture.
    """
    picture = _ask(client.take_screenshot)
    for _ in range(9):
        last, picture = picture, _ask(client.take_screenshot)
        if picture == last:
            break
    return picture


def _pages(design: dict[str, Any]) -> list[tuple[dict[str, str], list[str]]]:
    """Which tabs to open, one choice after the other, so that each view is seen on one page.

    A choice is {container of tabs: its active tab}; with it come the views to look at.
    """
    root = design["/viewport"]["ViewportBlueprint"]["root_container"]
    found = list(_leaves(design, f"/container/{root}", {}))
    choices: list[dict[str, str]] = []
    for choice, _ in found:
        wider = any(choice.items() < other.items() for other, _ in found)
        if not wider and choice not in choices:
            choices.append(choice)
    pages: list[tuple[dict[str, str], list[str]]] = [(choice, []) for choice in choices]
    for choice, view in found:
        next(shown for whole, shown in pages if choice.items() <= whole.items()).append(view)
    return pages


def _leaves(
    design: dict[str, Any], node: str, choice: dict[str, str]
) -> Iterator[tuple[dict[str, str], str]]:
    if node.startswith("/view/"):
        yield choice, node
        return
    container = design[node]["ContainerBlueprint"]
    children = container.get("contents", [])
    # The viewer writes a list of one as its only element.
    for name in [children] if isinstance(children, str) else children:
        child = "/" + name.strip("/")
        tab = {node: child} if container.get("container_kind") == "Tabs" else {}
        yield from _leaves(design, child, {**choice, **tab})


def _view_id(node: str) -> str:
    return node.removeprefix("/view/").replace("-", "")


def _free(name: str, taken: dict[str, Path]) -> str:
    number, free = 1, name
    while free in taken:
        number += 1
        free = f"{name} ({number})"
    return free


def _slug(name: str) -> str:
    return re.sub(r"\W+", "-", name).strip("-").lower()


def _first_line(error: Exception) -> str:
    return str(error).splitlines()[0] if str(error) else type(error).__name__
