"""The page of a results folder: complete, escaped, and honest about what is missing."""

import html
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import pandas as pd
import pytest

from study.common.errors import BadInput
from study.common.files import read_json, write_json
from study.config.names import FULL, RESIDUAL
from study.multiverse import folder
from study.page.write import NAME, write_page
from tests.helpers.multiverse import multiverse
from tests.helpers.running import files
from tests.helpers.synthetic import scores
from tests.page.conftest import FAILED, write_study

EVIL = "<img src=x onerror='alert(1)'>"
VOID = {"meta", "link", "br", "input", "img", "rect", "path", "use", "line", "circle", "stop"}


class Page(HTMLParser):
    """The elements of a page: what a browser sees, as far as tests need it."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.open: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert tag in VOID or self.open.pop() == tag

    def values(self, attribute: str) -> list[str]:
        return [v for _, attrs in self.elements if (v := attrs.get(attribute)) is not None]


@pytest.fixture(scope="session")
def text(published: Path) -> str:
    before = files(published)
    path = write_page(published)
    content = path.read_text(encoding="utf-8")
    path.unlink()
    assert files(published) == before, "a page changes no other file"
    return content


def test_every_section_is_there_in_the_order_of_a_reader(text: str) -> None:
    sections = [attributes["id"] for tag, attributes in Page(text).elements if tag == "section"]
    assert sections == [
        "question", "problems", "answer", "mmd", "brier", "claims", "models", "systems", "cells",
        "scores", "fits", "settings", "origin",
    ]  # fmt: skip


def test_elements_are_closed_and_names_are_unique(text: str) -> None:
    page = Page(text)
    assert page.open == []
    names = page.values("id")
    assert len(names) == len(set(names))
    targets = [v.removeprefix("#") for v in page.values("href") if v.startswith("#")]
    assert set(targets) <= set(names)


def test_it_loads_nothing(text: str) -> None:
    page = Page(text)
    assert page.values("src") == []
    for tag, attributes in page.elements:
        address = attributes.get("href") or attributes.get("xlink:href") or ""
        if tag != "a":
            assert address.startswith(("#", "data:")) or not address, address
        assert not re.match(r"[a-z+]+:(?<!data:)", address), address
    policy = next(a["content"] for t, a in page.elements if "http-equiv" in a)
    assert policy is not None
    assert policy.startswith("default-src 'none';")
    assert "unsafe-eval" not in policy


def test_the_same_folder_gives_the_same_page(published: Path, copy: Path, text: str) -> None:
    assert write_page(copy).read_text(encoding="utf-8") == text


def test_numbers_are_those_of_the_claims_and_say_where_they_come_from(
    published: Path, text: str
) -> None:
    plain = html.unescape(text)
    for claim in read_json(published / "claims.json"):
        assert claim["text"] in plain
        for finding in claim["findings"]:
            effect = f"{finding['effect']:+.4f}".replace("-", "−")
            assert effect.replace("+0.0000", "0.0000").replace("−0.0000", "0.0000") in plain
    assert "uav/low/residual_vae, all seeds\nscores.parquet: metric = brier" in plain
    assert "n = 60 scenarios × 2 seeds" in plain


def test_figures_have_texts_that_can_be_selected_and_alt_texts(text: str) -> None:
    assert ">forecast step</text>" in text
    figures = [a for t, a in Page(text).elements if t == "svg" and a.get("class") == "figure"]
    assert len(figures) >= 3
    assert all(len(figure["aria-label"] or "") > 40 for figure in figures)


def test_a_step_of_a_curve_shows_the_values_of_all_models(text: str) -> None:
    found = re.search(r"<title>(UAV, step 20: MMD².*?)</title>", text, re.DOTALL)
    assert found is not None
    lines = found[1].splitlines()
    assert any(line.startswith("residual VAE, high epistemic: 0.") for line in lines)
    assert sum(line.startswith("oracle: ") for line in lines) == 1


def test_a_failed_cell_is_named_and_has_no_score(text: str) -> None:
    rows = re.findall(r"<tr>.*?</tr>", text, re.DOTALL)
    (row,) = [row for row in rows if f">{FAILED}<" in row]
    assert re.findall(r"<td[^>]*>([^<]*)<", row)[:4] == ["failed", "—", "—", "—"]


def test_a_recording_is_a_link_within_the_folder(text: str) -> None:
    assert f'href="recordings/uav/low/{FULL}/seed-0/tuning.rrd"' in text


def test_without_scores_the_verdicts_are_still_shown(copy: Path) -> None:
    (copy / "scores.parquet").write_bytes(b"PAR1 and no more")
    text = write_page(copy).read_text(encoding="utf-8")
    assert "damaged: scores.parquet" in text
    assert 'id="answer"' in text
    assert 'id="brier-uav"' not in text
    assert str(copy) not in text


def test_names_that_are_html_are_text(tmp_path: Path) -> None:
    table = scores(seeds=1)
    table = table[(table.environment == "uav")].assign(environment=EVIL)
    table = table.replace({"model": {FULL: f"{EVIL}&{{{{7*7}}}}"}})
    out = write_study(tmp_path / "evil", table, name=EVIL)
    facts = read_json(out / "study.json")
    write_json(out / "study.json", facts | {"failed": [f"{EVIL}/low/a/seed-0"], "device": EVIL})
    text = write_page(out).read_text(encoding="utf-8")
    assert EVIL not in text
    assert html.escape(EVIL) in text.replace("&#34;", "&quot;").replace("&#39;", "&#x27;")
    assert [tag for tag, _ in Page(text).elements].count("img") == 0
    assert "{{7*7}}" in text.replace("&#123;", "{")


def test_a_foreign_system_has_no_verdicts_and_its_own_question(tmp_path: Path) -> None:
    table = scores(seeds=1)
    table = table[(table.environment == "uav") & (table.level == "low")]
    table = table.assign(environment="cart").replace({"model": {FULL: "my_flow"}})
    text = write_page(write_study(tmp_path / "cart", table)).read_text(encoding="utf-8")
    assert "How well do the models forecast?" in text
    assert 'id="answer"' not in text
    assert "without the variation of training" in text, "one seed"
    assert "my flow" in text


def test_a_study_with_scores_alone(published: Path, tmp_path: Path) -> None:
    pd.read_parquet(published / "scores.parquet").to_parquet(tmp_path / "scores.parquet")
    text = write_page(tmp_path).read_text(encoding="utf-8")
    assert "missing: study.json" in text
    assert 'id="figure-mmd_uav"' in text


def test_a_multiverse_shows_its_specification_curves_and_failures(tmp_path: Path) -> None:
    found = multiverse()
    full = found.cells[found.cells["model"] == RESIDUAL].assign(model=FULL)
    cells = pd.concat([found.cells, full], ignore_index=True)
    facts = {"settings": {"name": EVIL}, "versions": {}}
    folder.write(replace(found, cells=cells, facts=facts), tmp_path)
    text = write_page(tmp_path).read_text(encoding="utf-8")
    sections = [attributes["id"] for tag, attributes in Page(text).elements if tag == "section"]
    assert sections[:2] == ["question", "multiverse"]
    assert text.count('id="figure-specification_') == 4
    assert text.count('id="figure-vae_scores') == 1
    assert "universes, in the order of the effect</text>" in text
    assert "train pusher/low/full_vae/seed-0: it | broke" in text
    assert EVIL not in text
    assert Page(text).open == []


def test_a_damaged_multiverse_is_a_problem(tmp_path: Path) -> None:
    folder.write(multiverse(), tmp_path)
    (tmp_path / folder.EFFECTS).write_bytes(b"PAR1")
    text = write_page(tmp_path).read_text(encoding="utf-8")
    assert 'id="problems"' in text
    assert str(tmp_path) not in text


def test_outcomes_have_their_skill(text: str) -> None:
    start = text.index('id="outcomes-uav"')
    part = text[start : text.index("Download outcomes-uav.csv")]
    assert ">skill</th>" in part
    assert "scores.parquet: metric = brier_fair" in part


@pytest.mark.parametrize("exists", [True, False])
def test_a_folder_without_results_is_refused(tmp_path: Path, exists: bool) -> None:
    out = tmp_path if exists else tmp_path / "none"
    with pytest.raises(BadInput, match="run the study first" if exists else "there is no folder"):
        write_page(out)
    assert not (out / NAME).exists()
