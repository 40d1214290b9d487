"""Command `forecast`: forecast a test scenario, or a plan from a file."""

import math
import tempfile
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated
from uuid import uuid4

import numpy as np
from rich.console import Console
from rich.table import Table

from study.commands.command import DEFAULT_OUT, Command, Flag
from study.commands.machine import check_samples
from study.commands.terminal import Bar, console, say, show
from study.common.errors import BadInput
from study.common.files import why_not_writable
from study.results import folder

if TYPE_CHECKING:  # torch takes seconds to import
    from study.envs import Simulator
    from study.recording.examples import Example
    from study.results.forecast import Request

DETAILS = """\
Needs only the weights of a study, without training or data.

a plan has these columns, with the names and units of study/envs/README.md:
  s0.NAME      the initial state, one value:        s0.x, s0.y, …
  goal.NAME    the goal, one value:                 goal.target_x, …
  action.NAME  the action of each control step:     action.vx, …
In CSV the first row has a value in every column; in the other rows s0 and goal are empty.
In JSON: {"s0": {"x": 0.0, …}, "goal": {…}, "action": {"vx": [1.0, …], …}}.

examples
  python -m study.run forecast --cell uav/high/residual_vae/seed-0 --scenario 17 --samples 200
  python -m study.run forecast --cell uav/high/residual_vae/seed-0 --scenario 17 --write plan.csv
  python -m study.run forecast --cell uav/high/residual_vae/seed-0 --file plan.csv --save my.rrd"""

STEPS = 5
"""Number of control steps, evenly spaced, at which standard deviations are printed."""


@dataclass(frozen=True, kw_only=True)
class Options:
    """Options of `forecast`.

    Attributes:
        cell: name of the cell whose forecaster is used.
        scenario: index of a test scenario.
        file: a plan that replaces that of the scenario.
        samples: number of forecasts; None for the study's number.
        save: path of the recording; None writes a temporary one and opens the viewer.
        write: file to which the plan is written; no forecast is made then.
        out: the results folder.
    """

    cell: Annotated[str, Flag("whose forecaster is used: uav/high/residual_vae/seed-0")]
    scenario: Annotated[
        int | None, Flag("a test scenario, from 0 on; with --file, the one whose noise is used")
    ] = None
    file: Annotated[Path | None, Flag("a plan of your own, .csv or .json")] = None
    samples: Annotated[int | None, Flag("number of forecasts; as in the study by default")] = None
    save: Annotated[Path | None, Flag("FILE.rrd to write, in place of opening the viewer")] = None
    write: Annotated[Path | None, Flag("write the plan to this .csv or .json file, and stop")] = (
        None
    )
    out: Annotated[Path, Flag(f"results folder; {DEFAULT_OUT} by default")] = DEFAULT_OUT


def run(options: Options) -> int:
    """Forecast, print a summary, and write the recording or open it in the viewer."""
    if options.scenario is None and options.file is None:
        raise BadInput("--scenario: its value is missing; give one, or a plan with --file")
    if options.samples is not None and options.samples < 2:
        raise BadInput(f"--samples: got {options.samples}; it must be at least 2")
    if options.save is not None and options.save.suffix != ".rrd":
        raise BadInput(f"--save: got '{options.save}'; it must be a .rrd file")
    _check_targets(options)
    results = folder.read(options.out)
    cell = results.cell(options.cell, "--cell")

    from study.data.plan_files import write_plan
    from study.recording.viewer import check_display, open_viewer
    from study.results.forecast import Request, forecast, read_request, record

    request = Request(results, cell, options.scenario or 0, options.file, options.samples)
    plan, (simulator, _) = read_request(request), request.real_system()
    if options.write is not None:
        write_plan(options.write, simulator, plan)
        print(options.write)
        return 0
    if options.samples is not None:
        check_samples("--samples", options.samples, plan.actions.shape[0] * plan.s0.size)
    if options.save is None:
        check_display()
    terminal = console()
    if changed := results.origin.changed_source([cell]):
        say(terminal, f"note: {options.out}: {changed}")
    with Bar(terminal) as bar:
        example = forecast(request, plan, bar)
    print_forecast(terminal, request, simulator, example)
    # A temporary recording is not removed, since the viewer reads it after this process has ended.
    path = options.save or Path(tempfile.gettempdir(), f"study-{uuid4().hex}", "forecast.rrd")
    record(path, request, simulator, example)
    if options.save is None:
        open_viewer([path])
    print(f"\nrecording: {path}")
    return 0


def _check_targets(options: Options) -> None:
    """Check before the forecast that files can be written.

    Raises:
        BadInput: a file is not writable.
    """
    for flag, path in (("--save", options.save), ("--write", options.write)):
        if path is not None:
            problem = why_not_writable(path.parent)
            if problem or path.is_dir():
                raise BadInput(f"{flag}: {problem or f'{path} is a folder; give a file'}")


def print_forecast(
    terminal: Console, request: "Request", simulator: "Simulator", example: "Example"
) -> None:
    """Print the probability of each outcome, and standard deviations of the position."""
    from study.results.forecast import finite_samples

    steps = len(example.actions)
    duration = f"{steps} steps, {simulator.control_step * steps:.3g} s"
    say(terminal, f"{request.cell.name}, {request.title}: {request.description}")
    counts = f"{len(example.forecast)} forecasts and {len(example.observed)} observed rollouts"
    say(
        terminal,
        f"{counts} of {duration}" if simulator.control_step else f"{counts}, {steps} steps",
    )
    if infinite := int((~finite_samples(example)).sum()):
        say(terminal, f"{infinite} forecasts are not finite and count as none of the outcomes")
    if outcomes := outcome_rows(simulator, example):
        _print(terminal, ("outcome", "forecast", "±", "observed"), outcomes)
    if not simulator.has_target:
        say(terminal, "\nmedian of the state, and the interval of 90 %")
        _print(terminal, *state_rows(simulator, example))
    if not simulator.has_position:
        return
    columns = ("total", "aleatoric", "epistemic", "observed")
    header = ("step", "time [s]", *(f"{column} [{simulator.position_unit}]" for column in columns))
    say(terminal, "\nstandard deviation of the position")
    _print(terminal, header, std_rows(simulator, example))


def outcome_rows(simulator: "Simulator", example: "Example") -> list[tuple[str, ...]]:
    """Outcome, forecast probability, standard error of its estimate, and observed probability."""
    from study.results.forecast import outcome_probabilities

    rows: list[tuple[str, ...]] = []
    for name, (forecast, observed) in outcome_probabilities(simulator, example).items():
        error = (forecast * (1 - forecast) / len(example.forecast)) ** 0.5
        seen = "–" if math.isnan(observed) else f"{observed:.3f}"
        rows.append((name, f"{forecast:.3f}", f"{error:.3f}", seen))
    return rows


def std_rows(simulator: "Simulator", example: "Example") -> list[tuple[str, ...]]:
    """Step, time and standard deviations. Without an ensemble the parts are dashes."""
    from study.results.forecast import position_std

    std = position_std(simulator, example, STEPS)
    columns = (std.total, std.aleatoric, std.epistemic, std.observed)
    return [
        (
            str(step),
            f"{step * simulator.control_step:.3g}",
            *("–" if column is None else _number(column[index]) for column in columns),
        )
        for index, step in enumerate(std.step)
    ]


def state_rows(
    simulator: "Simulator", example: "Example"
) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Median and central 90 % of the forecasts of each state variable: the header, and the rows."""
    steps = np.unique(np.linspace(0, len(example.actions), STEPS + 1).round().astype(int)[1:])
    low, middle, high = np.quantile(example.forecast, (0.05, 0.5, 0.95), axis=0)
    rows = [
        (
            variable.name,
            *(f"{middle[t, d]:.3g} ({low[t, d]:.3g}, {high[t, d]:.3g})" for t in steps - 1),
        )
        for d, variable in enumerate(simulator.state)
    ]
    return ("", *(f"step {step}" for step in steps)), rows


def _number(value: float) -> str:
    return f"{value:.4g}" if abs(value) < float("inf") else "–"


def _print(terminal: Console, header: Sequence[str], rows: Iterable[tuple[str, ...]]) -> None:
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    for index, column in enumerate(header):
        table.add_column(column, justify="right" if index else "left")
    for row in rows:
        table.add_row(*row)
    terminal.print()
    show(terminal, table)


COMMAND = Command(
    "forecast",
    "forecast a test scenario, or a plan from a file, with the weights of a study",
    Options,
    run,
    DETAILS,
)
