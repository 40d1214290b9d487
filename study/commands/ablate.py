"""Command `ablate`: change one setting at a time, and compare the effects on validation data.

The changes are in the setting `ablations`. A stage that does not depend on a change runs only once,
since its task is the same.
"""

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from study.commands.command import Command, StudyOptions
from study.commands.settings import change
from study.commands.terminal import console, say
from study.commands.variants import Variants, last_tasks, run_missing, tasks_of
from study.common.errors import BadInput, shown
from study.common.files import read_json, write_json, write_text
from study.common.provenance import versions
from study.config.grid import Cell
from study.config.names import label
from study.config.settings import Config
from study.results.folder import check_writable, create, settings_of
from study.workflow.lock import locked
from study.workflow.store import Store

DETAILS = """\
Each change has the form of settings on the command line, without dashes. β is searched for again
with every change. The test set is not used. OUT gets README.md, a table for each environment and
level, and ablations.json.

examples
  python -m study.run ablate --config configs/ablations.yaml
  python -m study.run ablate --ablations '[vae.decoder_output=mean, vae.latent_size=2]'
  python -m study.run ablate --ablations '[vae.latent_size=2 vae.hidden_size=16]'"""

UNCHANGED = "as it is"

EXPLANATION = """\
# Ablations

One choice was changed at a time, and everything else left as it is. β was searched for again with
each change (in brackets), with the same budget. All scores are on validation scenarios; the test
set was not used. A dash (–) means that a change does not concern a model.

- **MMD²**, averaged over the horizon and the dimensions of the state: 0 is ideal.
- **skill** of the fair Brier score of the goal: 0 for the climatology, 1 for the expected score of
  the oracle.
- **variance ratio**: forecast variance / true variance, the median over dimensions and over the
  steps from the eleventh on: 1 is ideal.
"""

Scores = Mapping[str, Any]
"""The scores that the stage validate wrote for one cell."""


@dataclass(frozen=True, kw_only=True)
class Options(StudyOptions):
    """Options of `ablate`: the settings alone."""


def run(options: Options) -> int:
    """Run the stages that are not up to date, and write the tables."""
    from study.workflow.pipeline import Pipeline

    out, terminal = options.out, console()
    configs = changed_configs(options.config)
    check_writable(out)
    variants = last_tasks(configs, options.only, Pipeline.validate, references=False)
    create(out)
    store = Store(out / "work")
    with locked(out) as lock:
        errors = run_missing(tasks_of(variants), options.config, store, terminal)
        for task, error in errors.items():
            say(terminal, f"{task.name}: {error}")
        lock.verify()
        say(terminal, str(write(out, options.config, variants, store)))
    return 1 if errors else 0


def changed_configs(config: Config) -> dict[str, Config]:
    """The settings with each change of `ablations`; first, under "", without a change.

    Raises:
        BadInput: there is no change, or a change is not allowed.
    """
    if not config.ablations:
        raise BadInput(
            "ablations: nothing to change; --config configs/ablations.yaml has a list, or give "
            "--ablations '[vae.decoder_output=mean]'"
        )
    configs = {"": config}
    for text in config.ablations:
        try:
            configs[text] = change(config, [f"--{word}" for word in shlex.split(text)])
        except (BadInput, ValueError) as error:  # ValueError: quotes that do not close
            raise BadInput(f"ablations: {shown(text)}: {error}") from None
    return configs


def write(out: Path, config: Config, variants: Variants, store: Store) -> Path:
    """Write ``README.md``, with a table for each environment and level, and ``ablations.json``.

    Args:
        out: the results folder.
        config: the settings without a change.
        variants: the task `validate` of every cell, by change; first, under "", without a change.
            A cell whose task failed has the entry `failed`.
        store: the folders of the tasks.

    Returns:
        the path of the page.
    """
    scores = {
        text: {
            cell.name: read_json(store.folder(task) / "validation.json")
            for cell, task in by_cell.items()
            if store.reason_to_run(task) is None
        }
        for text, by_cell in variants.items()
    }
    grid = list(variants[""])
    lines = [EXPLANATION]
    for environment, level in dict.fromkeys((cell.environment, cell.level) for cell in grid):
        part = [cell for cell in grid if (cell.environment, cell.level) == (environment, level)]
        lines += [f"## {label(environment)}, {label(level)}", ""]
        lines += [*_table(part, variants, scores), ""]
    seeds = len({cell.seed for cell in grid})
    lines.append(
        f"{seeds} seed{'s' * (seeds > 1)}. Written by `python -m study.run ablate` with the "
        "settings and versions in `ablations.json`, which has the scores of every cell as well."
    )
    by_change = {text or UNCHANGED: by_cell for text, by_cell in scores.items()}
    facts = {"settings": settings_of(config), "versions": versions(), "scores": by_change}
    write_json(out / "ablations.json", facts)
    path = out / "README.md"
    write_text(path, "\n".join(lines) + "\n")
    return path


def _table(
    grid: Sequence[Cell], variants: Variants, scores: Mapping[str, Mapping[str, Scores]]
) -> list[str]:
    """A Markdown table with a row for each change and a column for each model."""
    models = list(dict.fromkeys(cell.model for cell in grid))
    columns = " | ".join(f"{label(model)}: MMD², skill, variance ratio" for model in models)
    lines = [f"| change | {columns} |", f"|---|{'---|' * len(models)}"]
    for text, by_cell in variants.items():
        entries = []
        for model in models:
            by_seed = [cell for cell in grid if cell.model == model]
            if text and all(by_cell[cell] == variants[""][cell] for cell in by_seed):
                entries.append("–")
            else:
                entries.append(_entry([scores[text].get(cell.name) for cell in by_seed]))
        lines.append(f"| {f'`{text}`' if text else UNCHANGED} | {' | '.join(entries)} |")
    return lines


def _entry(by_seed: Sequence[Scores | None]) -> str:
    """The scores of a model with a change: means over seeds, the range of MMD², and every β."""
    scores = [score for score in by_seed if score is not None]
    if len(scores) < len(by_seed):
        return "failed"
    mmd2 = [score["mmd2"] for score in scores]
    seed_range = f" ({min(mmd2):.3f}–{max(mmd2):.3f})" if len(mmd2) > 1 else ""
    skill, ratio = (_mean(scores, name) for name in ("brier_skill", "variance_ratio"))
    betas = [f"{score['beta']:.2g}" for score in scores if score["beta"] is not None]
    beta_list = f" [β {', '.join(betas)}]" if betas else ""
    return f"**{np.mean(mmd2):.3f}**{seed_range}, {skill}, {ratio}{beta_list}"


def _mean(scores: Sequence[Scores], name: str) -> str:
    values = [score[name] for score in scores if score[name] is not None]
    return f"{np.mean(values):.2f}" if values else "?"


COMMAND = Command(
    "ablate",
    "change one setting at a time, and compare the effects on validation data",
    Options,
    run,
    DETAILS,
)
