"""Whether a results folder is what it says: files, redrawn tables and figures, a cell run again.

    python -m study.run verify results/paper --rerun uav/high/residual_vae/seed-0

Tables, claims and figures are made again from the scores in a folder beside and compared byte for
byte. A figure whose bytes differ is still the same if its picture is: the pixels of a PNG, the
unpacked streams of a PDF (another zlib packs the same content into other bytes). So are claims with
the same numbers to nine digits (another processor adds up in another order).

A cell that is evaluated again on the same machine, with the same versions, has the same scores, bit
for bit. Another processor or another version adds up in another order, and the last digits differ:
a recurrent network passes that on from step to step, and now and then a forecast falls on the other
side of a threshold, which moves the probability of one scenario by 1/K. So it passes if every score
over all scenarios differs by at most `TOLERANCE`, and so do `MOST` of all; the largest difference
is told. (Plain torch in place of the compiled recurrences moves quick's scores by 0.0001 at most.)
"""

import re
import shutil
import tempfile
import zlib
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from study.common.errors import StudyError
from study.common.files import read_json, same_bytes
from study.common.progress import Progress
from study.common.provenance import versions
from study.config.grid import Cell
from study.config.settings import Engine
from study.models.checkpoints import save_model
from study.recording import integrity as recordings
from study.results import checksums, publish
from study.results.folder import Stored
from study.stages import collect, evaluate
from study.workflow.pipeline import Pipeline
from study.workflow.store import Store
from study.workflow.worker import prepare

TOLERANCE = 0.001
"""Of a score, or beyond 1 of its size: three digits are what the tables print."""
MOST = 0.99
"""The share of all scores that keep to it: that of one scenario moves with one forecast."""
AGAIN = "python -m study.run all makes it again, or restore it from where it came"
KEYS = ("metric", "dimension", "step", "scenario")


@dataclass(frozen=True)
class Found:
    """What one check found."""

    name: str
    ok: bool
    text: str

    @property
    def line(self) -> str:
        """For the terminal."""
        return f"{'ok' if self.ok else 'DIFFERS':8} {self.name:10} {self.text}"


def verify(study: Stored, rerun: Cell | None, progress: Progress) -> Iterator[Found]:
    """Every check in turn.

    Args:
        study: the results folder.
        rerun: a cell to evaluate again; None for none.
        progress: told how far it is.
    """
    progress(0.0, "checksums")
    damaged = checksums.problems(study.out)
    yield from check_files(study, damaged)
    yield check_recordings(study)
    yield from check_drawn(study, damaged, progress.part(0.05, 0.4 if rerun else 1.0))
    if rerun is not None:
        yield check_scores(study, rerun, progress.part(0.4, 1.0))
    here = versions()
    other = [f"{n} {v} (here {here.get(n)})" for n, v in study.versions.items() if here.get(n) != v]
    if other:
        text = f"made with {', '.join(other)}: digits and pictures may differ for that alone"
        yield Found("versions", True, text)


def check_files(study: Stored, damaged: list[str]) -> Iterator[Found]:
    """Every file against ``SHA256SUMS``."""
    if not damaged:
        count = len(checksums.read(study.out))
        yield Found("files", True, f"{count} files are as {checksums.NAME} says")
    for problem in damaged:
        yield Found("files", False, f"{problem}; {AGAIN}")


def check_recordings(study: Stored) -> Found:
    """Every recording against the checksum beside it."""
    paths = sorted((study.out / "recordings").rglob("*.rrd"))
    for path in paths:
        try:
            recordings.check(path)
        except StudyError as error:
            return Found("recordings", False, f"{error}; {AGAIN}")
    return Found("recordings", True, f"{len(paths)} recordings match their checksums")


def check_drawn(study: Stored, damaged: list[str], progress: Progress) -> Iterator[Found]:
    """Claims, tables and figures against those that the scores give."""
    sources = [publish.SCORES, publish.TRIALS, "illustrations", checksums.NAME]
    broken = [line for line in damaged if any(f"{study.out / name}" in line for name in sources)]
    if broken:
        text = f"not drawn again, since what they are drawn from is not whole: {broken[0]}"
        yield Found("figures", False, text)
        return
    with tempfile.TemporaryDirectory(prefix="study-verify-") as place:
        again = Path(place)
        for name in (publish.SCORES, publish.TRIALS):
            shutil.copyfile(study.out / name, again / name)
        if (study.out / "illustrations").is_dir():
            shutil.copytree(study.out / "illustrations", again / "illustrations")
        progress(0.1, "claims")
        publish.judge(pd.read_parquet(again / publish.SCORES), again)
        yield compare_files("claims", study.out, again, "claims.*")
        progress(0.3, "tables and figures")
        publish.draw(again)
        progress(1.0, "tables and figures")
        yield compare_files("tables", study.out, again, "tables/*")
        yield compare_files("figures", study.out, again, "figures/*")


def compare_files(name: str, out: Path, again: Path, pattern: str) -> Found:
    """The files of `out` with those made `again`, byte for byte, or by what they show or say."""
    ours, theirs = (
        {path.relative_to(folder).as_posix() for path in folder.glob(pattern)}
        for folder in (out, again)
    )
    if ours != theirs:
        first = sorted(ours ^ theirs)[0]
        where = "is missing" if first in theirs else "is not one that the scores give"
        return Found(name, False, f"{out / first} {where}; {AGAIN}")
    repacked = 0
    for path in sorted(ours):
        if not same_bytes(out / path, again / path):
            why = why_other(out / path, again / path)
            if why:
                return Found(name, False, f"{out / path} {why}; {AGAIN}")
            repacked += 1
    text = f"{len(ours)} files drawn again from the scores: the same bytes"
    return Found(name, True, text if not repacked else f"{text}, or of {repacked} the same content")


def why_other(stored: Path, again: Path) -> str | None:
    """In what two files differ that are not the same bytes; None if they show or say the same."""
    if stored.suffix == ".png":
        from matplotlib.image import imread

        try:
            one, other = imread(stored), imread(again)
        except (OSError, SyntaxError, ValueError):
            return "is no PNG any more"
        if one.shape != other.shape:
            return "is of another size"
        moved = (one != other).any(axis=-1)
        return f"differs in {moved.mean():.2%} of its pixels" if moved.any() else None
    if stored.suffix == ".pdf" and _streams(stored) == _streams(again):
        return None
    if stored.suffix == ".json":
        try:
            if _alike(read_json(stored), read_json(again)):
                return None
        except ValueError:
            return "is no JSON any more"
    return "is not what the scores give"


def _alike(one: Any, other: Any) -> bool:
    """Whether two JSON values are the same, their numbers to nine digits."""
    if isinstance(one, dict) and isinstance(other, dict):
        return one.keys() == other.keys() and all(_alike(one[key], other[key]) for key in one)
    if isinstance(one, list) and isinstance(other, list):
        return len(one) == len(other) and all(map(_alike, one, other))
    if isinstance(one, float) and isinstance(other, float):
        return bool(np.isclose(one, other, rtol=1e-9, atol=1e-12, equal_nan=True))
    return bool(one == other)


def check_scores(study: Stored, cell: Cell, progress: Progress) -> Found:
    """The stored scores of a cell against those of a new evaluation."""
    try:
        again = evaluate_again(study, cell, progress)
    except StudyError as error:
        return Found("scores", False, str(error))
    scores = pd.read_parquet(study.out / publish.SCORES)
    of_cell = np.logical_and.reduce([scores[name] == value for name, value in asdict(cell).items()])
    return compare_scores(cell.name, scores[of_cell].reset_index(drop=True), again)


def evaluate_again(study: Stored, cell: Cell, progress: Progress) -> pd.DataFrame:
    """The scores of a cell, from its shipped weights.

    Raises:
        StudyError: the weights are missing or damaged.
    """
    from study.commands.forecast import load_forecaster, simulator_of

    task = Pipeline(study.config).evaluate(cell)
    prepare(study.config.plugins, Engine().threads)
    with tempfile.TemporaryDirectory(prefix="study-verify-") as place:
        out, model = Path(place, "evaluate"), Path(place, "model")
        out.mkdir()
        model.mkdir()
        forecaster: Any = load_forecaster(study, cell, simulator_of(study, cell.environment))
        if cell.model == "ensemble":
            save_model(forecaster, "ensemble", model / "ensemble.safetensors")
        elif cell.model != "oracle":
            shutil.copyfile(study.weights(cell), model / "model.safetensors")
        store, observed = Store(study.out / "work"), task.inputs["data"]
        data = store.folder(observed)
        if store.why_not(observed) is not None:
            data = Path(place, "data")
            data.mkdir()
            collect.run(dict(observed.settings), {}, data, progress.part(0.0, 0.6))
        inputs = {"data": data, "trained": model, "ensemble": model}
        evaluate.run(dict(task.settings), inputs, out, progress.part(0.6, 1.0))
        return publish.as_published(pd.read_parquet(out / publish.SCORES))


def compare_scores(name: str, stored: pd.DataFrame, again: pd.DataFrame) -> Found:
    """Scores of the same cell: all the same, or how far apart."""
    keys = list(KEYS)
    if not stored[keys].astype(str).equals(again[keys].astype(str)):
        text = f"{name}: {len(stored)} scores are stored, and {len(again)} found: not the same ones"
        return Found("scores", False, text)
    old, new = stored.value.to_numpy(np.float64), again.value.to_numpy(np.float64)
    if np.array_equal(old, new, equal_nan=True):
        return Found("scores", True, f"{name}: {len(old)} evaluated again: the same numbers")
    with np.errstate(invalid="ignore"):
        apart = np.abs(new - old) / np.maximum(1.0, np.abs(old))
    same = (old == new) | (np.isnan(old) & np.isnan(new))
    apart = np.where(same, 0.0, np.where(np.isnan(apart), np.inf, apart))
    overall = (stored.scenario == -1).to_numpy()
    worst, within = int(apart.argmax()), float((apart <= TOLERANCE).mean())
    row = stored.iloc[worst]
    where = ", ".join(f"{key} {row[key]}" for key in keys)
    text = (
        f"{name}: {len(old)} evaluated again: largest difference {apart[worst]:.2g} ({where}), "
        f"of one over all scenarios {apart[overall].max():.2g}; "
        f"{within:.2%} of all within {TOLERANCE:g}, at least {MOST:.0%} must be"
    )
    return Found("scores", bool(apart[overall].max() <= TOLERANCE and within >= MOST), text)


def _streams(path: Path) -> list[bytes]:
    """The parts of a PDF, unpacked: the rest is where in the file they are."""
    parts = []
    for stream in re.findall(rb"stream\r?\n(.*?)endstream", path.read_bytes(), re.DOTALL):
        try:
            parts.append(zlib.decompress(stream))
        except zlib.error:
            parts.append(stream)
    return parts
