"""The page and the recordings in Chromium: what a reader sees and does.

`SCREENSHOTS` in the environment names a folder in which screenshots are kept.
"""

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import pytest
from PIL import Image

from study.config.names import FULL
from study.page.server import Server
from study.page.write import write_page
from study.recording.forecast import record_forecast
from tests.helpers import recordings
from tests.helpers.browser import browser

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

pytestmark = pytest.mark.browser

SIZES = {"phone": (390, 844), "desktop": (1440, 1000)}
SMALL = {"small": (900, 600)}
SERIOUS = {"serious", "critical"}
LEAST_COLOURS = 200
"""Distinct colours of a picture that is not blank."""


@pytest.fixture(scope="module")
def chromium() -> "Iterator[Browser]":
    with browser() as started:
        yield started


@pytest.fixture(scope="module")
def address(published: Path, tmp_path_factory: pytest.TempPathFactory) -> str:
    page = write_page(published)
    path = tmp_path_factory.mktemp("alone") / "page.html"
    return page.rename(path).as_uri()


class Watched:
    """A page, with the messages of its console and the addresses that it asks for."""

    def __init__(self, page: "Page") -> None:
        self.page = page
        self.errors: list[str] = []
        self.requests: list[str] = []
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))
        self.page.on("request", lambda request: self.requests.append(request.url))
        self.page.on(
            "console",
            lambda m: self.errors.append(m.text) if m.type in ("error", "warning") else None,
        )


Theme = Literal["light", "dark"]
Open = Callable[..., Watched]


@pytest.fixture(params=["light", "dark"])
def theme(request: pytest.FixtureRequest) -> Theme:
    name: Theme = request.param
    return name


@pytest.fixture
def open_page(chromium: "Browser") -> Iterator[Open]:
    """Opens an address in a context of its own, which is closed after the test."""
    contexts = []

    def opened(address: str, size: str = "desktop", **options: Any) -> Watched:
        width, height = (SIZES | SMALL)[size]
        context = chromium.new_context(viewport={"width": width, "height": height}, **options)
        contexts.append(context)
        watched = Watched(context.new_page())
        watched.page.goto(address)
        return watched

    yield opened
    for context in contexts:
        context.close()


@pytest.fixture
def desktop(open_page: Open, address: str) -> "Iterator[Page]":
    watched = open_page(address)
    yield watched.page
    assert watched.errors == []


@pytest.mark.parametrize("size", SIZES)
def test_it_is_readable_at_both_widths_and_in_both_themes(
    open_page: Open, address: str, theme: Theme, size: str
) -> None:
    watched = open_page(address, size, color_scheme=theme)
    page, (width, _) = watched.page, SIZES[size]
    _keep(page, f"page_{theme}_{size}")
    assert page.evaluate("document.documentElement.scrollWidth") == width, "nothing is cut off"
    for section in page.query_selector_all("section"):
        box = section.bounding_box()
        assert box is not None
        assert box["height"] > 40
    ground = page.evaluate("getComputedStyle(document.body).backgroundColor")
    red = int(ground.split("(")[1].split(",")[0])
    assert (red < 60) == (theme == "dark")
    assert watched.errors == []
    assert watched.requests == [address], "no request but for the page"


@pytest.mark.parametrize("size", SIZES)
def test_accessibility_without_serious_findings(
    open_page: Open, address: str, theme: Theme, size: str
) -> None:
    from axe_playwright_python.sync_playwright import Axe

    # The policy of the page forbids every script but its own, and so that of the checker.
    page = open_page(address, size, color_scheme=theme, bypass_csp=True).page
    page.evaluate("document.querySelectorAll('details').forEach((d) => { d.open = true; })")
    found = Axe().run(page).response["violations"]
    serious = [
        (rule["id"], node["target"], node["failureSummary"])
        for rule in found
        if rule["impact"] in SERIOUS
        for node in rule["nodes"][:3]
    ]
    assert serious == []


def _column(page: "Page", table: str, column: int) -> list[str]:
    texts: list[str] = page.eval_on_selector_all(
        f"#{table} tbody tr:not([hidden])",
        f"(rows) => rows.map((row) => row.cells[{column}].firstChild.textContent)",
    )
    return texts


def test_a_table_is_sorted_by_its_numbers(desktop: "Page") -> None:
    before = _column(desktop, "all-cells", 2)
    head = desktop.locator("#all-cells thead th").nth(2)
    head.get_by_role("button").click()
    assert head.get_attribute("aria-sort") == "ascending"
    ascending = _column(desktop, "all-cells", 2)
    assert sorted(before) == sorted(ascending)
    numbers = [float(text.replace("−", "-")) for text in ascending if text != "—"]
    assert numbers == sorted(numbers)
    assert len(set(numbers)) > 5
    assert ascending[-1] == "—", "what has no number comes last"
    head.get_by_role("button").click()
    assert head.get_attribute("aria-sort") == "descending"
    assert _column(desktop, "all-cells", 2)[-len(numbers) :] == ascending[: len(numbers)][::-1]


def test_a_table_is_filtered_by_words(desktop: "Page") -> None:
    desktop.locator("#all-cells input").fill("UAV full")
    shown = _column(desktop, "all-cells", 0)
    assert shown
    assert all("uav" in name and "full" in name for name in shown)
    assert desktop.locator("#all-cells .count").inner_text().startswith(f"{len(shown)} of ")
    desktop.locator("#all-cells input").fill("")
    assert len(_column(desktop, "all-cells", 0)) > len(shown)


def test_a_number_can_be_traced_by_tap_and_by_keys(desktop: "Page") -> None:
    trace = desktop.locator("#trace")
    assert trace.inner_text() == ""
    number = desktop.locator("#brier-uav td.number").first
    number.click()
    assert "scores.parquet: metric = brier" in trace.inner_text()
    first = trace.inner_text()
    desktop.keyboard.press("ArrowRight")
    assert trace.inner_text() != first
    desktop.keyboard.press("Escape")
    assert trace.inner_text() == ""


def test_a_step_of_a_curve_can_be_read(desktop: "Page") -> None:
    step = desktop.locator("#figure-mmd_uav rect.step").nth(9)
    step.scroll_into_view_if_needed()
    step.click()
    assert desktop.locator("#trace").inner_text().startswith("UAV, step 10: MMD²\n")


def test_a_claim_unfolds_where_a_link_leads(desktop: "Page") -> None:
    link = desktop.locator("#answer tbody a").first
    link.click()
    target = desktop.locator("details.claim").first
    target.locator("table").wait_for(state="visible", timeout=5000)


def test_a_table_can_be_downloaded(desktop: "Page", tmp_path: Path) -> None:
    with desktop.expect_download() as download:
        desktop.locator("#all-scores .download a").click()
    download.value.save_as(tmp_path / "scores.csv")
    lines = (tmp_path / "scores.csv").read_text(encoding="utf-8").splitlines()
    assert lines[0] == "environment,level,model,metric,estimate,low,high,seeds,scenarios"
    assert len(lines) == 1 + len(_column(desktop, "all-scores", 0))


def test_in_print_every_claim_is_unfolded_on_white(desktop: "Page") -> None:
    desktop.emulate_media(media="print", color_scheme="dark")
    desktop.evaluate("dispatchEvent(new Event('beforeprint'))")
    assert desktop.locator("details.claim:not([open])").count() == 0
    assert not desktop.locator("nav").is_visible()
    ground = desktop.evaluate("getComputedStyle(document.body).backgroundColor")
    assert ground in ("rgb(255, 255, 255)", "rgba(0, 0, 0, 0)")


def test_models_keep_their_colours_in_the_dark(open_page: Open, address: str) -> None:
    """Vermilion and orange, of the full VAE and the full CRPS, stay apart."""
    colours = {}
    for theme in ("light", "dark"):
        page = open_page(address, color_scheme=theme).page
        strokes = page.eval_on_selector_all(
            "#figure-mmd_uav path", "(all) => all.map((path) => getComputedStyle(path).stroke)"
        )
        colours[theme] = set(strokes) - {"none"}
    assert "rgb(213, 94, 0)" in colours["light"] & colours["dark"]
    assert "rgb(27, 31, 35)" in colours["light"] - colours["dark"], "axes have the colour of text"
    assert "rgb(228, 231, 234)" in colours["dark"] - colours["light"]


def test_a_claim_shows_its_figure_again(desktop: "Page") -> None:
    claim = desktop.locator("details.claim:has(use)").first
    claim.locator("summary").click()
    figure = claim.locator("svg.figure use")
    box = figure.bounding_box()
    assert box is not None
    assert min(box["width"], box["height"]) > 100


@pytest.mark.slow
def test_a_link_opens_the_scenario_in_the_viewer_of_the_package(
    open_page: Open, tmp_path: Path
) -> None:
    recording = tmp_path / "out" / RECORDING
    recording.parent.mkdir(parents=True)
    puck = recordings.Puck()
    record_forecast(recording, puck, recordings.examples(puck, 2), {"cell": "a/b/c/seed-0"})
    link = f"{RECORDING}?tab=1"
    with Server(tmp_path / "out", page=lambda out: f"<a href='{link}'>open</a>") as server:
        thread = Thread(target=server.serve_forever, daemon=True)
        thread.start()
        watched = open_page(server.address, "small")
        watched.page.click("text=open")
        watched.page.wait_for_selector("canvas", timeout=60_000)
        layout = f"{server.address}layouts/1/{RECORDING.replace('.rrd', '.rbl')}"
        for _ in range(60):
            watched.page.wait_for_timeout(500)
            watched.page.screenshot(path=tmp_path / "viewer.png")
            if server.address + RECORDING in watched.requests[1:] and _is_drawn(tmp_path):
                break
        _keep(watched.page, "viewer")
        server.shutdown()
        assert _is_drawn(tmp_path)
        assert watched.requests.index(layout) < watched.requests.index(
            server.address + RECORDING, 3
        ), "the viewer uses the first layout"
        assert all(url.startswith((server.address, "blob:")) for url in watched.requests)


RECORDING = f"recordings/uav/low/{FULL}/seed-0/forecast.rrd"


def _is_drawn(folder: Path) -> bool:
    """Whether the last screenshot of the viewer has many colours."""
    pixels = np.asarray(Image.open(folder / "viewer.png").convert("RGB")).reshape(-1, 3)
    return len(np.unique(pixels, axis=0)) >= LEAST_COLOURS


def _keep(page: "Page", name: str) -> None:
    if folder := os.environ.get("SCREENSHOTS"):
        Path(folder).mkdir(parents=True, exist_ok=True)
        page.screenshot(path=Path(folder) / f"{name}.png", full_page=False)
