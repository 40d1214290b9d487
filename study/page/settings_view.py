"""The settings of a study, its versions and its cost, as tables."""

import json
from collections.abc import Mapping
from typing import Any

from study.common.errors import BadInput
from study.config.convert import by_dotted_name
from study.config.settings import Config
from study.page.evidence import Evidence
from study.page.tables import Table, Value, figure, text
from study.results.folder import settings_of

MEGABYTE = 1e6


def settings(evidence: Evidence) -> tuple[Table | None, Table | None]:
    """The settings that differ from the defaults, and all settings."""
    values = by_dotted_name(evidence.settings)
    if not values:
        return None, None
    try:
        defaults = by_dotted_name(json.loads(json.dumps(settings_of(Config()))))
    except BadInput:
        defaults = {}
    rows = {name: (value, defaults.get(name)) for name, value in sorted(values.items())}
    different = {name: pair for name, pair in rows.items() if pair[0] != pair[1]}
    heads = ["setting", "value", "default"]
    return (
        Table(
            "settings-different",
            "Settings that differ from the defaults",
            heads,
            _rows(different),
            tools=True,
        ),
        Table("settings-all", "All settings", heads, _rows(rows), tools=True),
    )


def _rows(values: Mapping[str, tuple[Any, Any]]) -> list[list[Value]]:
    return [
        [text(name), text(shown(value)), text(shown(default))]
        for name, (value, default) in values.items()
    ]


def shown(value: Any) -> str:
    """A setting in one line."""
    if value is None:
        return "—"
    if isinstance(value, list | tuple):
        return ", ".join(map(str, value)) or "none"
    return str(value).lower() if isinstance(value, bool) else str(value)


def versions(evidence: Evidence) -> Table:
    """Versions of packages, the machine, and how the study ran."""
    facts = evidence.facts
    entries: dict[str, Any] = {
        "study": facts.get("study"),
        "machine": facts.get("device"),
        "compiler": facts.get("compiler"),
        "threads of a stage": facts.get("threads"),
        **{f"engine: {name}": value for name, value in _flat(evidence.engine).items()},
    }
    packages = facts.get("versions")
    if isinstance(packages, Mapping):
        entries |= {str(name): version for name, version in packages.items()}
    rows = [[text(name), text(value)] for name, value in entries.items() if value not in (None, "")]
    return Table("versions", "Versions and machine", ["", "value"], rows)


def source_digests(evidence: Evidence) -> Table | None:
    """The digest of every module that a stage reached."""
    source = evidence.facts.get("source")
    if not isinstance(source, Mapping) or not source:
        return None
    rows = [[text(name), text(digest)] for name, digest in source.items()]
    return Table("source", "Source: digest of each module", ["module", "SHA-256"], rows, tools=True)


def stages(evidence: Evidence) -> Table | None:
    """What the stages cost."""
    if not evidence.costs:
        return None
    by_stage: dict[str, list[Mapping[str, float]]] = {}
    for name, cost in evidence.costs.items():
        by_stage.setdefault(name.split(" ")[0], []).append(cost)
    rows = []
    for stage, costs in by_stage.items():
        trace = f"timings.json: {stage}"
        rows.append(
            [
                text(stage),
                figure(float(len(costs)), trace, 0),
                figure(sum(cost.get("cpu_seconds", 0.0) for cost in costs), trace, 0),
                figure(sum(cost.get("seconds", 0.0) for cost in costs), trace, 0),
                figure(max(c.get("peak_memory", 0.0) for c in costs) / MEGABYTE, trace, 0),
            ]
        )
    heads = ["stage", "tasks", "CPU seconds", "wall seconds", "peak memory, MB"]
    return Table("stages", "Cost of each stage", heads, rows, tools=True)


def _flat(values: Mapping[str, Any]) -> dict[str, Any]:
    return {name.removeprefix("engine."): value for name, value in by_dotted_name(values).items()}
