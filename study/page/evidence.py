"""What a results folder has, for its page. A missing or damaged file is a problem, not an error."""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import pandas as pd

from paper_figs.scores import read_scores
from study.common.errors import BadInput, StudyError
from study.common.files import read_json
from study.multiverse.folder import FACTS as MULTIVERSE
from study.results import checksums, timings
from study.results.folder import STUDY
from study.results.summary import CLAIMS, FITS, SCORES, TRIALS

ABLATIONS = "ablations.json"
T = TypeVar("T")


@dataclass(frozen=True)
class Evidence:
    """The content of a results folder.

    Attributes:
        out: the folder.
        name: of the study.
        facts: of ``study.json``, or else of ``multiverse.json``; empty without both.
        scores: of all cells; None without them.
        claims: of ``claims.json``.
        trials: of the searches for β; None without them.
        fits: of the fitted models; None without them.
        costs: of each task, by its name (`study.results.timings.read`).
        engine: the other entries of ``timings.json``.
        ablations: of ``ablations.json``; None without it.
        recordings: the names of the recordings, relative to the folder.
        problems: one line for each file that is damaged or missing.
    """

    out: Path
    name: str
    facts: Mapping[str, Any]
    scores: pd.DataFrame | None
    claims: Sequence[Mapping[str, Any]]
    trials: pd.DataFrame | None
    fits: pd.DataFrame | None
    costs: Mapping[str, Mapping[str, float]]
    engine: Mapping[str, Any]
    ablations: Mapping[str, Any] | None
    recordings: Sequence[str]
    problems: Sequence[str] = field(default_factory=tuple)

    @property
    def settings(self) -> Mapping[str, Any]:
        """The settings of the study."""
        settings = self.facts.get("settings") or (self.ablations or {}).get("settings")
        return settings if isinstance(settings, Mapping) else {}

    @property
    def failed(self) -> list[str]:
        """The names of the cells that failed."""
        failed = self.facts.get("failed", [])
        return [str(name) for name in failed] if isinstance(failed, list) else []

    @property
    def failures(self) -> list[str]:
        """One line for each stage of a universe that failed."""
        failures = self.facts.get("failures", [])
        names = ("universe", "stage", "error")
        return [
            ": ".join(str(failure.get(name, "")) for name in names)
            for failure in (failures if isinstance(failures, list) else [])
            if isinstance(failure, Mapping)
        ]

    @property
    def failed_models(self) -> set[tuple[str, str, str]]:
        """Environment, level and model of the cells that failed."""
        parts = (tuple(name.split("/")) for name in self.failed)
        return {(part[0], part[1], part[2]) for part in parts if len(part) == 4}


def check_folder(out: Path) -> None:
    """Check that a folder has results.

    Raises:
        BadInput: there is no such folder, or it has no study, no ablations and no multiverse.
    """
    if not out.is_dir():
        raise BadInput(f"there is no folder {out}: give the results folder of a study")
    if not any((out / name).is_file() for name in (STUDY, SCORES, ABLATIONS, MULTIVERSE)):
        raise BadInput(f"{out} has no results: run the study first: python -m study.run all")


def read(out: Path) -> Evidence:
    """Read a results folder.

    Raises:
        BadInput: there is no such folder, or it has no study, no ablations and no multiverse.
    """
    check_folder(out)
    problems: list[str] = []
    is_study = any((out / name).is_file() for name in (STUDY, SCORES))
    reader = _Reader(out, problems if is_study else [])
    facts = reader.read(STUDY, _mapping) or {}
    if not facts and (out / MULTIVERSE).is_file():
        facts = reader.read(MULTIVERSE, _mapping) or {}
    settings = facts.get("settings")
    settings = settings if isinstance(settings, Mapping) else {}
    evidence = Evidence(
        out=out,
        name=str(settings.get("name", out.resolve().name)),
        facts=facts,
        scores=reader.read(SCORES, lambda path: read_scores(path.parent)),
        claims=reader.read(CLAIMS, _claims) or (),
        trials=reader.read(TRIALS, pd.read_parquet),
        fits=reader.read(FITS, pd.read_parquet),
        costs=timings.read(out),
        engine={
            key: value
            for key, value in (reader.read(timings.NAME, _mapping) or {}).items()
            if key not in timings.PER_STAGE
        },
        ablations=reader.read(ABLATIONS, _mapping) if (out / ABLATIONS).is_file() else None,
        recordings=_recordings(out),
        problems=problems,
    )
    if is_study and (out / checksums.NAME).is_file():
        problems += [_within(line, out) for line in checksums.problems(out)]
    return evidence


@dataclass(frozen=True)
class _Reader:
    out: Path
    problems: list[str]

    def read(self, name: str, parse: Callable[[Path], T]) -> T | None:
        """A file, or None if it cannot be read, which is noted as a problem."""
        path = self.out / name
        if not path.is_file():
            self.problems.append(f"missing: {name}")
            return None
        try:
            return parse(path)
        except (StudyError, OSError, ValueError, KeyError, TypeError) as error:
            first_line = next(iter(str(error).splitlines()), "")
            self.problems.append(f"damaged: {name} ({_within(first_line, self.out)})")
            return None


def _within(line: str, out: Path) -> str:
    """A message with paths relative to the folder."""
    return line.replace(f"{out}/", "").replace(str(out), ".")


def _mapping(path: Path) -> Mapping[str, Any]:
    content = read_json(path)
    if not isinstance(content, dict):
        raise ValueError("it is not a JSON object")
    return content


def _claims(path: Path) -> list[Mapping[str, Any]]:
    content = json.loads(path.read_text(encoding="utf-8"))
    if not isinstance(content, list) or not all(isinstance(entry, dict) for entry in content):
        raise ValueError("it is not a list of claims")
    for entry in content:
        if missing := {"id", "section", "text", "verdict", "findings"} - entry.keys():
            raise ValueError(f"a claim has no {', '.join(sorted(missing))}")
    return content


def _recordings(out: Path) -> list[str]:
    paths = (out / "recordings").rglob("*.rrd")
    return sorted(path.relative_to(out).as_posix() for path in paths if path.is_file())
