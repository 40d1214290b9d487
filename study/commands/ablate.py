"""What each choice is worth: one changed at a time, all fitted alike, scored on validation data.

`python -m study.run ablate` takes the changes from the setting `ablations`. Whatever a change does
not touch is fitted once: its stages are the same, and so are their folders.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from study.common.files import read_json, write_json, write_text
from study.common.provenance import versions
from study.config.grid import Cell, cells, select
from study.config.names import label
from study.config.settings import Config
from study.results.folder import settings_of
from study.workflow.pipeline import Pipeline
from study.workflow.store import Store, Task

Planned = dict[str, dict[Cell, Task]]
"""The last stage of every cell, by what was changed."""

AS_IT_IS = "as it is"

EXPLANATION = """\
# What was tried

One choice was changed at a time and everything else left as it is, β searched for anew each time
(the number in brackets), with the same budget each time. All scores are on validation
scenarios; the test set was not looked at. A line (–) stands where a change does not concern a
model.

- **MMD²** averaged over the horizon and the dimensions of the state: 0 is right.
- **skill**: Brier skill of the task's outcome, 0 the climatology, 1 an oracle.
- **width**: forecast variance / true variance from the tenth step on, the median of steps and
  dimensions: 1 is right.
"""


def plan(variants: Mapping[str, Config], only: str | None = None) -> Planned:
    """Which stages there are, of the cells whose name matches `only`."""
    planned = {}
    for change, config in variants.items():
        pipeline = Pipeline(config)
        chosen = [cell for cell in select(cells(config), only) if not cell.is_reference]
        planned[change] = {cell: pipeline.validate(cell) for cell in chosen}
    return planned


def write(out: Path, config: Config, planned: Planned, store: Store) -> Path:
    """Write ``README.md``, a table for each environment and level, and ``ablations.json``.

    Args:
        out: the results folder.
        config: the settings as they are.
        planned: from `plan`.
        store: where the stages are. What has failed is told as `failed`.
    """
    scores = {
        change: {
            cell.name: read_json(store.folder(task) / "validation.json")
            for cell, task in tasks.items()
            if store.why_not(task) is None
        }
        for change, tasks in planned.items()
    }
    grid = list(planned[""])
    lines = [EXPLANATION]
    for environment, level in dict.fromkeys((cell.environment, cell.level) for cell in grid):
        here = [cell for cell in grid if (cell.environment, cell.level) == (environment, level)]
        models = list(dict.fromkeys(cell.model for cell in here))
        lines += [f"## {label(environment)}, {level} epistemic", "", _header(models)]
        for change, tasks in planned.items():
            entries = []
            for model in models:
                mine = [cell for cell in here if cell.model == model]
                same = change and all(tasks[cell] == planned[""][cell] for cell in mine)
                entries.append("–" if same else _entry([scores[change].get(c.name) for c in mine]))
            lines.append(f"| {f'`{change}`' if change else AS_IT_IS} | {' | '.join(entries)} |")
        lines.append("")
    seeds = len({cell.seed for cell in grid})
    lines.append(
        f"{seeds} seed{'s' * (seeds > 1)}. Made by `python -m study.run ablate` with the settings "
        "and versions in `ablations.json`, which has the scores of every cell as well."
    )
    told = {change or AS_IT_IS: of_cells for change, of_cells in scores.items()}
    facts = {"settings": settings_of(config), "versions": versions(), "scores": told}
    write_json(out / "ablations.json", facts)
    path = out / "README.md"
    write_text(path, "\n".join(lines) + "\n")
    return path


def _header(models: list[str]) -> str:
    names = " | ".join(f"{label(model)}: MMD², skill, width" for model in models)
    return f"| change | {names} |\n|---|{'---|' * len(models)}"


def _entry(told: list[dict[str, Any] | None]) -> str:
    """What one change does to one model: the mean over seeds, and of MMD² the range."""
    scores = [score for score in told if score is not None]
    if len(scores) < len(told):
        return "failed"
    values = [score["mmd2"] for score in scores]
    between = f" ({min(values):.3f}–{max(values):.3f})" if len(values) > 1 else ""
    skill, width = (_mean(scores, name) for name in ("brier_skill", "variance_ratio"))
    return f"**{np.mean(values):.3f}**{between}, {skill}, {width}{_betas(scores)}"


def _mean(scores: list[dict[str, Any]], name: str) -> str:
    known = [score[name] for score in scores if score[name] is not None]
    return f"{np.mean(known):.2f}" if known else "?"


def _betas(scores: list[dict[str, Any]]) -> str:
    known = [f"{score['beta']:.2g}" for score in scores if score["beta"] is not None]
    return f" [β {', '.join(known)}]" if known else ""
