"""The tables of the page about speed, from the files that the benchmarks write."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from paper_figs.formatting import NOTHING, number
from paper_figs.pages.marks import pipe_table
from study.common.files import read_json
from study.config.names import label

NOT_MEASURED = "*Not measured yet: `make benchmarks` does it.*"
Rows = list[dict[str, Any]]


def tables(root: Path) -> dict[str, Callable[[], str]]:
    """The functions that write the tables, by name: one for each benchmark.

    Args:
        root: the folder of the repository.
    """
    folder = root / "tests" / "benchmarks" / "results"
    writers = {
        "simulation": simulation,
        "evaluation": evaluation,
        "training": training,
        "forecasting": forecasting,
        "scale": scale,
        "cluster": cluster,
    }
    return {
        name: lambda name=name, write=write: _table(folder / f"{name}.json", write)  # type: ignore[misc]
        for name, write in writers.items()
    }


def _table(path: Path, write: Callable[[Rows], str]) -> str:
    if not path.is_file():
        return NOT_MEASURED
    record = read_json(path)
    machine = record["machine"]
    cores = f"{machine['cores']} core{'s' if machine['cores'] != 1 else ''}"
    return f"{write(record['rows'])}\n\n{machine['processor']}, {cores}, {machine['system']}."


def simulation(rows: Rows) -> str:
    """Control steps per second, and the ratio of the batch's rate to each rate."""
    environments = list(dict.fromkeys(row["environment"] for row in rows))
    rates = {(row["contender"], row["environment"]): row["rate"] for row in rows}
    lines = []
    for contender in dict.fromkeys(row["contender"] for row in rows):
        line = [contender]
        for environment in environments:
            rate = rates.get((contender, environment))
            times = rates["batch", environment] / rate if rate else None
            line += [_rate(rate), number(times, 1)]
        lines.append(line)
    heads = [f"{label(name)}{text}" for name in environments for text in ("", ": batch / this")]
    return pipe_table(["control steps per second", *heads], lines)


def evaluation(rows: Rows) -> str:
    """Seconds and memory of each way to compute MMD²."""
    lines = [
        [
            row["contender"],
            f"{row['seconds']:.1f}",
            f"{row['gigabytes']:.2f}",
            NOTHING if row["difference"] is None else f"{row['difference']:.0e}",
        ]
        for row in rows
    ]
    heads = ["", "seconds", "peak memory, GB", "largest difference from ours"]
    return pipe_table(heads, lines)


def training(rows: Rows) -> str:
    """Transitions per second of a training step, and ratios to each contender."""
    return _rates(rows, ("size",))


def forecasting(rows: Rows) -> str:
    """Sampled transitions per second of a forecast, and ratios to each contender."""
    return _rates(rows, ("environment", "size"))


def _rates(rows: Rows, groups: tuple[str, ...]) -> str:
    """A line for each model: its rate, and the ratios of its rate to those of the contenders."""
    contenders = list(dict.fromkeys(row["contender"] for row in rows if row["contender"] != "ours"))
    cells: dict[tuple[str, ...], dict[str, dict[str, Any]]] = {}
    for row in rows:
        key = (*(row[group] for group in groups), row["model"])
        cells.setdefault(key, {})[row["contender"]] = row
    lines = []
    for key, by_contender in cells.items():
        ratios = [
            _ratio(by_contender[name]["ratio"]) if name in by_contender else NOTHING
            for name in contenders
        ]
        lines.append([", ".join(map(label, key)), _rate(by_contender["ours"]["rate"]), *ratios])
    return pipe_table(["", "transitions / s", *(f"× {name}" for name in contenders)], lines)


def scale(rows: Rows) -> str:
    """The cost of the largest size of each series, and the exponent p of seconds ~ size^p."""
    lines = [
        [
            f"{row['setting']}: {row['work']}",
            f"{row['sizes'][0]:,} to {row['sizes'][-1]:,}",
            f"{row['seconds'][-1]:.2f}",
            f"{row['memory'][-1] / 1e6:,.0f}",
            number(row["exponent"], 2),
        ]
        for row in rows
    ]
    heads = ["", "sizes", "seconds at the largest", "MB at the largest", "exponent of seconds"]
    return pipe_table(heads, lines)


def cluster(rows: Rows) -> str:
    """How busy simulated workers are, and the cost of a stage that is not the stage's own."""
    lines = [
        [
            f"{row['loss']:.0%}",
            f"{row['stages']:,} on {row['workers']}",
            f"{row['lost']:,}",
            f"{row['busy']:.0%}",
            f"{row['wasted']:.0%}",
            f"{row['scheduler_ms']:.2f}",
            f"{row['worker_ms']:.1f}",
            f"{row['our_share']:.2%}",
        ]
        for row in rows
    ]
    heads = ["probability that a stage's worker is lost", "stages on workers", "lost workers"]
    heads += ["workers busy", "of it for lost stages", "scheduler, ms a stage"]
    return pipe_table([*heads, "lease and folder, ms a stage", "both, of the workers' time"], lines)


def _rate(rate: float | None) -> str:
    return NOTHING if rate is None else f"{rate:,.0f}"


def _ratio(ratio: list[float]) -> str:
    """Median, and in brackets the least and the greatest over the repeats."""
    median, least, greatest = ratio
    return f"{median:.2f} ({least:.2f}–{greatest:.2f})"
