"""Files are UTF-8 whatever the locale, and a terminal shows what it can."""

import ast
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.helpers.running import ROOT

SOURCES = [
    path for folder in ("study", "paper_figs") for path in sorted((ROOT / folder).rglob("*.py"))
]
ASCII = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0", "PYTHONIOENCODING": "ascii"}
LOCALES = {
    "ascii": ASCII,
    "latin": ASCII | {"PYTHONIOENCODING": "iso-8859-1"},
    "strict": ASCII | {"PYTHONIOENCODING": "ascii:strict"},
}


def _calls_without_encoding(path: Path) -> Iterator[str]:
    """Calls of a module that read or write text in the encoding of the locale."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if not isinstance(node, ast.Call):
            continue
        name = node.func.attr if isinstance(node.func, ast.Attribute) else ""
        if isinstance(node.func, ast.Name) and node.func.id == "open":
            name = "open"
        keywords = {keyword.arg for keyword in node.keywords}
        modes = {argument.value for argument in node.args if isinstance(argument, ast.Constant)}
        is_text = name in ("read_text", "write_text")
        is_text |= name in ("run", "Popen", "check_output") and "text" in keywords
        is_text |= name == "open" and any(mode in modes for mode in ("r", "w", "a", "x"))
        if is_text and "encoding" not in keywords:
            # The study's own `write_text` is a function, and writes UTF-8.
            yield f"{path.name}:{node.lineno}: {ast.unparse(node)}"


@pytest.mark.parametrize("path", SOURCES, ids=[str(path.relative_to(ROOT)) for path in SOURCES])
def test_no_file_is_in_the_encoding_of_the_locale(path: Path) -> None:
    assert list(_calls_without_encoding(path)) == []


@pytest.mark.slow
@pytest.mark.parametrize("variables", LOCALES.values(), ids=LOCALES)
def test_settings_and_terminals_in_any_locale(tmp_path: Path, variables: dict[str, str]) -> None:
    config = tmp_path / "größe.yaml"
    config.write_text("# größer als β²\nname: small\n", encoding="utf-8")
    here = ["--config", str(config), "--out", str(tmp_path / "ausgäbe")]
    for command, code in ((["plan", *here], 0), (["plan", *here, "--train.β", "1"], 2)):
        done = subprocess.run(
            [sys.executable, "-m", "study.run", *command],
            cwd=ROOT,
            env=os.environ | variables,
            capture_output=True,
            check=False,
        )
        output = done.stdout + done.stderr
        assert b"Traceback" not in output
        assert done.returncode == code, output
        output.decode("iso-8859-1" if variables == LOCALES["latin"] else "ascii")
