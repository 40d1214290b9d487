"""Check a results folder: its files, its recordings, and what is computed from its scores.

Claims, tables and figures are written again from the scores, in a temporary folder, and compared
byte for byte. Files with different bytes may have the same content. Two PNG files are equal if
their pixels are. Two PDF files are equal if their unpacked streams are, since another zlib
compresses to other bytes. Two JSON files are equal if their numbers agree to nine digits, since
another processor rounds differently.
"""

import re
import shutil
import tempfile
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from study.common.errors import StudyError
from study.common.files import read_json, same_bytes
from study.common.progress import Progress
from study.common.provenance import versions
from study.common.read_back import why_incomplete
from study.config.grid import Cell
from study.recording import integrity
from study.results import checksums, summary
from study.results.folder import STUDY, Results

REMEDY = "restore it, or write it again: python -m study.run all"


@dataclass(frozen=True)
class Check:
    """The outcome of one check.

    Attributes:
        name: subject of the check.
        ok: whether the check passed.
        text: the result in words.
    """

    name: str
    ok: bool
    text: str

    @property
    def line(self) -> str:
        """The outcome in one line, for the terminal."""
        return f"{'ok' if self.ok else 'DIFFERS':8} {self.name:10} {self.text}"


def verify(results: Results, rerun: Cell | None, progress: Progress) -> Iterator[Check]:
    """Run every check.

    Args:
        results: the results folder.
        rerun: a cell to evaluate again; None for no cell.
        progress: called with the fraction done.

    Yields:
        the outcome of each check.
    """
    progress(0.0, "checksums")
    problems = checksums.problems(results.out)
    yield from check_files(results.out, problems)
    yield check_recordings(results.out)
    yield from check_summary(results, problems, progress.part(0.05, 0.4 if rerun else 1.0))
    if rerun is not None:
        yield check_scores(results, rerun, progress.part(0.4, 1.0))
    if changed := results.origin.changed_source([rerun] if rerun else results.complete):
        yield Check("source", True, changed)
    yield from check_versions(results.origin.versions)


def check_versions(made_with: Mapping[str, str]) -> Iterator[Check]:
    """Name the packages of which another version is installed."""
    installed = versions()
    different = [
        f"{name} {version} (installed: {installed.get(name)})"
        for name, version in made_with.items()
        if installed.get(name) != version
    ]
    if different:
        names = ", ".join(different)
        text = f"made with {names}: last digits and pictures may differ for that reason"
        yield Check("versions", True, text)


def check_files(out: Path, problems: list[str], remedy: str = REMEDY) -> Iterator[Check]:
    """Compare every file with ``SHA256SUMS``; `problems` are from `checksums.problems`."""
    if not problems:
        names = checksums.read(out)
        problems = [
            f"cut off before its checksum was made: {out / name} ({problem})"
            for name in names
            if (problem := why_incomplete(out / name)) is not None
        ]
    if not problems:
        yield Check("files", True, f"{len(names)} files match {checksums.NAME}")
    for problem in problems:
        yield Check("files", False, f"{problem}; {remedy}")


def check_recordings(out: Path, remedy: str = REMEDY) -> Check:
    """Compare every recording with the checksum file beside it."""
    paths = sorted((out / "recordings").rglob("*.rrd"))
    for path in paths:
        try:
            integrity.check(path)
        except StudyError as error:
            return Check("recordings", False, f"{error}; {remedy}")
    return Check("recordings", True, f"{len(paths)} recordings match their checksums")


def check_summary(results: Results, problems: list[str], progress: Progress) -> Iterator[Check]:
    """Compare claims, tables and figures with those that are computed from the scores."""
    sources = [summary.SCORES, summary.TRIALS, summary.FITS, "illustrations", checksums.NAME]
    damaged = [
        line for line in problems if any(f"{results.out / name}" in line for name in sources)
    ]
    if damaged:
        text = f"not plotted again, since their sources are damaged: {damaged[0]}"
        yield Check("figures", False, text)
        return
    with tempfile.TemporaryDirectory(prefix="study-verify-") as temporary:
        repeated = Path(temporary)
        # A study that was made before the study had the table of fits has none.
        fits = [summary.FITS] if (results.out / summary.FITS).is_file() else []
        for name in (summary.SCORES, summary.TRIALS, *fits, STUDY):
            shutil.copyfile(results.out / name, repeated / name)
        if (results.out / "illustrations").is_dir():
            shutil.copytree(results.out / "illustrations", repeated / "illustrations")
        progress(0.1, "claims")
        summary.write_claims(pd.read_parquet(repeated / summary.SCORES), repeated)
        yield compare_files("claims", results.out, repeated, "claims.*")
        progress(0.3, "tables and figures")
        summary.plot(repeated)
        progress(1.0, "tables and figures")
        yield compare_files("tables", results.out, repeated, "tables/*")
        yield compare_files("figures", results.out, repeated, "figures/*")


def check_scores(results: Results, cell: Cell, progress: Progress) -> Check:
    """Compare the scores of a cell with those of a new evaluation."""
    from study.results import rerun

    try:
        repeated = rerun.evaluate(results, cell, progress)
    except StudyError as error:
        return Check("scores", False, str(error))
    published = rerun.published_scores(results, cell)
    return Check("scores", *rerun.compare(cell.name, published, repeated))


def compare_files(
    name: str,
    out: Path,
    repeated: Path,
    *patterns: str,
    source: str = "the scores",
    remedy: str = REMEDY,
) -> Check:
    """Compare the files of `out` that match a pattern with those of `repeated`.

    Args:
        name: subject of the check.
        out: the results folder.
        repeated: a folder with the same files, written again.
        patterns: of the files.
        source: from what they were written again.
        remedy: what to do if they differ.
    """
    published, expected = (
        {path.relative_to(folder).as_posix() for each in patterns for path in folder.glob(each)}
        for folder in (out, repeated)
    )
    if published != expected:
        first = min(published ^ expected)
        problem = "is missing" if first in expected else f"does not follow from {source}"
        return Check(name, False, f"{out / first} {problem}; {remedy}")
    same_content = 0
    for path in sorted(published):
        if not same_bytes(out / path, repeated / path):
            if difference := content_difference(out / path, repeated / path):
                return Check(name, False, f"{out / path} {difference}; {remedy}")
            same_content += 1
    text = f"{len(published)} files written again from {source}: the same bytes"
    if same_content:
        text += f", or in {same_content} of them the same content"
    return Check(name, True, text)


def content_difference(published: Path, expected: Path) -> str | None:
    """The difference of the contents of two files, in words; None if the contents are the same."""
    if published.suffix == ".png":
        return _pixel_difference(published, expected)
    if published.suffix == ".pdf" and _streams(published) == _streams(expected):
        return None
    if published.suffix == ".json":
        try:
            if _nearly_equal(read_json(published), read_json(expected)):
                return None
        except ValueError:
            return "is not a JSON file"
    return "differs from the one that is written again"


def _pixel_difference(published: Path, expected: Path) -> str | None:
    from matplotlib.image import imread

    try:
        pixels, expected_pixels = imread(published), imread(expected)
    except (OSError, SyntaxError, ValueError):
        return "is not a PNG file"
    if pixels.shape != expected_pixels.shape:
        return "has another size"
    different = (pixels != expected_pixels).any(axis=-1)
    return f"differs in {different.mean():.2%} of its pixels" if different.any() else None


def _nearly_equal(a: Any, b: Any) -> bool:
    """Whether two JSON values are the same, with numbers compared to nine digits."""
    if isinstance(a, dict) and isinstance(b, dict):
        return a.keys() == b.keys() and all(
            _nearly_equal(value, b[key]) for key, value in a.items()
        )
    if isinstance(a, list) and isinstance(b, list):
        return len(a) == len(b) and all(map(_nearly_equal, a, b))
    if isinstance(a, float) and isinstance(b, float):
        return bool(np.isclose(a, b, rtol=1e-9, atol=1e-12, equal_nan=True))
    return bool(a == b)


def _streams(path: Path) -> list[bytes]:
    """The unpacked streams of a PDF. The other bytes of the file are the positions of streams."""
    streams = []
    for stream in re.findall(rb"stream\r?\n(.*?)endstream", path.read_bytes(), re.DOTALL):
        try:
            streams.append(zlib.decompress(stream))
        except zlib.error:
            streams.append(stream)
    return streams
