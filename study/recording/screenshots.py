"""Screenshots of recordings in the real viewer, without a screen."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from rerun.experimental import ViewerClient

from study.recording.integrity import check
from study.recording.viewer import ask, headless, wait_for

Design = dict[str, Any]
"""A blueprint: entity path, archetype, field."""


@dataclass(frozen=True)
class Screenshots:
    """The screenshots of a recording.

    Attributes:
        views: the PNG of each view, by name; views of the same name are numbered.
        pages: the PNG of the whole window for each page. A page is a choice of tabs.
        problems: errors in the viewer's log, and problems that views report.
    """

    views: dict[str, Path]
    pages: list[Path]
    problems: list[str]


def screenshots(path: Path, out_dir: Path) -> Screenshots:
    """Take a screenshot of every page and of every view of a recording, hidden tabs included.

    Raises:
        StudyError: there is no Vulkan driver, the recording is missing or damaged, or the viewer
            does not answer.
    """
    check(path)
    with headless() as client:
        out_dir.mkdir(parents=True, exist_ok=True)
        names, design = show(client, path)
        views: dict[str, Path] = {}
        pages: list[Path] = []
        problems: list[str] = []
        for page, (tabs, visible) in enumerate(_pages(design)):
            for container, tab in tabs.items():
                design[container]["ContainerBlueprint"]["active_tab"] = tab
            if tabs:
                ask(lambda: client.set_blueprint(design, "recording"))
            window = out_dir / f"{path.stem}-page-{page + 1:02d}.png"
            window.write_bytes(settled(client))
            pages.append(window)
            for view in visible:
                name = _numbered(names[view], views)
                file = out_dir / f"{path.stem}-{len(views) + 1:03d}-{_slug(name)}.png"
                identity = view.removeprefix("/view/")
                file.write_bytes(ask(partial(client.take_screenshot, identity)))
                views[name] = file
            problems += [
                f"{view.name}: {report.summary}"
                for view in ask(client.get_state).views
                for report in view.reports
            ]
        problems += [f"{e.target}: {e.message}" for e in ask(client.get_logs) if e.level == "ERROR"]
    return Screenshots(views, pages, problems)


def show(client: ViewerClient, path: Path) -> tuple[dict[str, str], Design]:
    """Open a recording at two thirds of its timeline, at which bodies and dots are moving.

    Returns:
        The name of each view, by its node ``/view/…`` in the blueprint; and the blueprint.
    """
    client.open(str(Path(path).resolve()))
    state = wait_for(client.get_state, lambda s: not s.loading and bool(s.views))
    timelines = {line.name: line for line in state.recordings[0].timelines}
    design: Design = ask(client.get_blueprint).blueprint
    active = design.get("/time_panel", {}).get("TimePanelBlueprint", {}).get("timeline")
    end = timelines[active].end if active in timelines else None
    if end is not None:
        start = timelines[active].start or 0
        time = start + 2 * (end - start) // 3
        ask(lambda: client.set_time(active, sequence=time, play_state="paused"))
    by_id = {view.view_id.replace("-", ""): view.name for view in state.views}
    nodes = [node for _, node in _leaves(design, root_of(design), {})]
    return {node: by_id[node.removeprefix("/view/").replace("-", "")] for node in nodes}, design


def root_of(design: Design) -> str:
    """The node of the container that fills the window."""
    return f"/container/{design['/viewport']['ViewportBlueprint']['root_container']}"


def settled(client: ViewerClient) -> bytes:
    """A PNG of the window, as soon as two successive ones are equal; at most the tenth.

    The viewer draws the plots of a new tab one frame late.
    """
    picture = ask(client.take_screenshot)
    for _ in range(9):
        previous, picture = picture, ask(client.take_screenshot)
        if picture == previous:
            break
    return picture


def _pages(design: Design) -> list[tuple[dict[str, str], list[str]]]:
    """The choices of tabs that together show every view, and the views of each choice.

    A choice is {container of tabs: its active tab}.
    """
    leaves = list(_leaves(design, root_of(design), {}))
    choices: list[dict[str, str]] = []
    for choice, _ in leaves:
        is_part = any(choice.items() < larger.items() for larger, _ in leaves)
        if not is_part and choice not in choices:
            choices.append(choice)
    pages: list[tuple[dict[str, str], list[str]]] = [(choice, []) for choice in choices]
    for choice, view in leaves:
        next(views for page, views in pages if choice.items() <= page.items()).append(view)
    return pages


def _leaves(
    design: Design, node: str, choice: dict[str, str]
) -> Iterator[tuple[dict[str, str], str]]:
    """Every view below a node, with the choice of tabs that shows it."""
    if node.startswith("/view/"):
        yield choice, node
        return
    container = design[node]["ContainerBlueprint"]
    children = container.get("contents", [])
    # The viewer writes a list of one element as that element.
    for name in [children] if isinstance(children, str) else children:
        child = "/" + name.strip("/")
        tab = {node: child} if container.get("container_kind") == "Tabs" else {}
        yield from _leaves(design, child, {**choice, **tab})


def _numbered(name: str, taken: dict[str, Path]) -> str:
    """The name, with a number if the name is taken."""
    number, numbered = 1, name
    while numbered in taken:
        number += 1
        numbered = f"{name} ({number})"
    return numbered


def _slug(name: str) -> str:
    return re.sub(r"\W+", "-", name).strip("-").lower()
