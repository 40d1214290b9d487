"""The pages of the repository: their links, commands and tables hold."""

import importlib.util
import re
import shlex
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from urllib.parse import urlsplit

import pytest

from paper_figs.pages.__main__ import outdated
from paper_figs.pages.marks import pages
from study.commands.parser import parse
from study.results.folder import read

ROOT = Path(__file__).parents[2]
PAGES = pages(ROOT)
CONFIGS = sorted((ROOT / "configs").glob("*.yaml"))
LINK = re.compile(r"\]\(([^()\s]+)\)|<img src=\"([^\"]+)\"")
CODE = re.compile(r"^```.*?^```$", re.MULTILINE | re.DOTALL)
WRITTEN = re.compile(r"--write (\S+\.yaml)")
YAML = re.compile(r"^```yaml\n(.*?)^```$", re.MULTILINE | re.DOTALL)
SHELL = re.compile(r"^```sh\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def _name(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def _commands(text: str) -> list[list[str]]:
    """The command lines in the shell blocks of a page, without their comments."""
    lines = "".join(SHELL.findall(text)).replace("\\\n", " ").splitlines()
    return [words for line in lines if (words := shlex.split(line, comments=True))]


def _anchors(text: str) -> set[str]:
    """What a link to a heading of the page may end in, by the rule of GitHub."""
    headings = re.findall(r"^#+ (.*)$", CODE.sub("", text), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def test_the_front_page_is_short() -> None:
    assert len((ROOT / "README.md").read_text().splitlines()) <= 150


@pytest.mark.parametrize("page", PAGES, ids=_name)
def test_links_lead_to_files_and_headings(page: Path) -> None:
    for link in map("".join, LINK.findall(CODE.sub("", page.read_text()))):
        parts = urlsplit(link)
        if parts.scheme:
            continue
        target = page.parent / parts.path if parts.path else page
        assert target.exists(), link
        if parts.fragment:
            assert parts.fragment in _anchors(target.read_text()), link


@pytest.mark.parametrize("page", [*PAGES, *CONFIGS], ids=_name)
def test_commands_can_be_run(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    text = page.read_text()
    if written := WRITTEN.findall(text):  # a command of the page writes the files of others
        monkeypatch.chdir(tmp_path)
        for name in written:
            Path(name).write_text(YAML.findall(text)[0], encoding="utf-8")
    if page in CONFIGS:
        found = re.search(r"^#     (python .*)$", text, re.MULTILINE)
        assert found, "the command is missing"
        text = f"```sh\n{found[1]}\n```"
    targets = re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(), re.MULTILINE)
    for program, *arguments in _commands(text):
        if program == "make":
            assert arguments[0] in targets
        elif Path(program).name == "python" and arguments[0] == "-m":
            _check_module(*arguments[1:])


def _check_module(module: str, *arguments: str) -> None:
    assert importlib.util.find_spec(module), module
    if module == "study.run":
        # Help ends the process.
        with suppress(SystemExit):
            parse(list(arguments))


def test_the_tables_are_those_of_the_committed_numbers() -> None:
    assert not [_name(page) for page in outdated(ROOT)], "run: make pages"


def test_the_configuration_of_the_committed_results() -> None:
    """It is ``configs/paper.yaml``, except for the engine, on which no number depends."""
    _, options = parse(["plan", "--config", str(ROOT / "configs" / "paper.yaml")])
    committed = read(ROOT / "results" / "paper").config
    assert replace(options.config, engine=committed.engine) == committed
