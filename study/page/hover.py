"""The values that a figure of the page shows on hover and tap."""

from collections.abc import Iterator, Mapping

import pandas as pd

from paper_figs.fig3_mmd import curve_values
from paper_figs.formatting import number
from paper_figs.scores import environments, levels, models
from study.config.names import ORACLE, label
from study.metrics.intervals import band

Hover = Mapping[int, str]
"""The text of each step."""


def mmd_steps(scores: pd.DataFrame) -> Iterator[tuple[str, Hover]]:
    """The values of the curves of each figure ``mmd_<environment>``, by step."""
    curves = scores[(scores["metric"] == "mmd2") & (scores["scenario"] >= 0) & (scores["step"] > 0)]
    for environment in environments(curves):
        part = curves[curves["environment"] == environment]
        lines: dict[int, list[str]] = {}
        for model in models(part):
            shown = levels(part)[:1] if model == ORACLE else levels(part)
            for level in shown:
                _add(lines, part, environment, level, model)
        heads = {step: f"{label(environment)}, step {step}: MMD²" for step in lines}
        yield f"mmd_{environment}", {step: "\n".join([heads[step], *lines[step]]) for step in lines}


def _add(
    lines: dict[int, list[str]], curves: pd.DataFrame, environment: str, level: str, model: str
) -> None:
    values = curve_values(curves, environment, level, model)
    if values is None:
        return
    found = band(values)
    name = label(model) if model == ORACLE else f"{label(model)}, {label(level)}"
    for index in range(values.shape[2]):
        estimate, low, high = (
            number(float(part[index])) for part in (found.estimate, found.low, found.high)
        )
        lines.setdefault(index + 1, []).append(f"{name}: {estimate} [{low}, {high}]")
