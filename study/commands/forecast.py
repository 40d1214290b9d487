"""Forecast one scenario from the weights that a study ships: no training, no scratch folder.

    python -m study.run forecast --cell uav/high/residual_vae/seed-0 --scenario 17 --samples 200

A test scenario is drawn again from the study's settings, to the same bits, and so are the seeds of
its observed runs and of its forecasts: with as many samples as the study took, these are the
forecasts that it scored. A plan from a file is observed and forecast with the noise of a test
scenario: so two plans may be compared with the same noise.
"""

import json
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from study.common.errors import BadInput, StudyError, nearest
from study.common.progress import Progress
from study.common.provenance import made_with
from study.common.seeds import Seeds, derive, spawn
from study.config.grid import Cell
from study.data.plan_files import Plan, read_plan
from study.data.trajectories import ScenarioSet, joined
from study.envs import Simulator
from study.envs.observe import real_system, repeat_rollouts, sample_planned, trajectory_seeds
from study.models import Forecaster
from study.models.checkpoints import load_model
from study.models.forecasting import picked
from study.models.oracle import Oracle
from study.recording.examples import as_example, position_variance
from study.recording.forecasts import Example, record_forecast
from study.recording.properties import table
from study.results import checksums
from study.results.folder import Stored
from study.workflow.pipeline import Pipeline

STEPS = 5
"""Steps at which the split is printed, evenly apart."""

README = """
# A forecast

From the beginning s₀ and the actions a₀ … a_{T−1} that the first tab names, the real system was run
K times (**observed**, grey) and the model forecast as many times as asked for (**forecast**, blue),
with the weights that the study ships.
"""


@dataclass(frozen=True)
class Question:
    """What is asked of a cell's forecaster.

    Attributes:
        study: the results folder.
        cell: whose forecaster.
        scenario: the test scenario whose noise, and without a plan whose s_0 and actions, are used.
        file: a plan of one's own.
        samples: K; None takes as many as the study did.
    """

    study: Stored
    cell: Cell
    scenario: int = 0
    file: Path | None = None
    samples: int | None = None

    @property
    def title(self) -> str:
        """What is forecast; what stands before the colon is short."""
        if self.file is None:
            return f"scenario {self.scenario}: from the test set"
        return f"{self.file.name}: a plan from a file, noise of test scenario {self.scenario}"


def simulator_of(study: Stored, environment: str) -> Simulator:
    """The real system, with the study's horizon."""
    return real_system(_collect(study, environment))[0]


def read_scenario(question: Question) -> Plan:
    """The plan that is forecast: that of the test scenario, drawn again, or of the file.

    Raises:
        BadInput: there is no such scenario, or the file cannot be used.
    """
    count = question.study.config.collect.scenarios
    if not 0 <= question.scenario < count:
        raise BadInput(
            f"--scenario: got {question.scenario}; the test set has {count}, 0 to {count - 1}"
        )
    simulator, seed = real_system(_collect(question.study, question.cell.environment))
    if question.file is not None:
        return read_plan(question.file, simulator)
    seeds, _ = trajectory_seeds(derive(seed, "test"), question.scenario + 1)
    scenario, actions = sample_planned(simulator, seeds[-1:])
    return Plan(scenario.s0[0], scenario.goal[0], actions[0])


def answer(question: Question, plan: Plan, progress: Progress) -> Example:
    """Observed runs and forecasts of a plan.

    Raises:
        StudyError: the cell's weights are missing or damaged.
    """
    study, cell = question.study, question.cell
    simulator, seed = real_system(_collect(study, cell.environment))
    forecaster = load_forecaster(study, cell, simulator)
    settings = Pipeline(study.config).evaluate(cell).settings
    samples = question.samples or int(settings["evaluate"]["samples"])
    _, noise = trajectory_seeds(derive(seed, "test"), question.scenario + 1)
    part = progress.part(0.0, 0.5)
    test = _observed(simulator, plan, study.config.collect.rollouts, noise[-1:], part)
    seeds = spawn(settings["seed"], question.scenario + 1)[-1:]
    progress(0.5, "forecasting")
    forecasts = forecaster.forecast(test.s0, test.actions, samples, seeds)
    progress(1.0, "forecasting")
    arrays = picked(forecaster, test, forecasts, seeds, np.array([0]))
    return as_example(arrays, 0, simulator, None, question.title)


def load_forecaster(study: Stored, cell: Cell, simulator: Simulator) -> Forecaster:
    """A cell's forecaster from what the study ships.

    The ensemble alone has no file of its own: it is inside every model that was fitted on it.

    Raises:
        StudyError: its weights are missing or damaged.
    """
    if cell.model == "oracle":
        return Oracle(simulator)
    if cell.model != "ensemble":
        return _load(study, cell)
    for other in study.complete:
        if study.ships(other) and replace(other, model="ensemble") == cell:
            inner = getattr(_load(study, other), "ensemble", None)
            if inner is not None:
                return inner
    raise StudyError(
        f"{cell.name}: the study ships no model with an ensemble at this level and seed"
    )


def print_answer(
    console: Console, question: Question, simulator: Simulator, example: Example
) -> None:
    """Print the probability of each outcome, and the split of the spread at a few steps."""
    console.print(
        f"{question.cell.name}, {question.title}\n{len(example.forecast)} forecasts and "
        f"{len(example.observed)} observed runs of {len(example.actions)} steps, "
        f"{simulator.control_step * len(example.actions):.3g} s",
        soft_wrap=True,
    )
    lost = int((~np.isfinite(example.forecast).all(axis=(1, 2))).sum())
    if lost:
        console.print(f"{lost} forecasts are not finite: they count as none of the outcomes")
    _print(console, OUTCOMES, outcome_rows(simulator, example))
    _print(console, SPREAD, spread_rows(simulator, example))


OUTCOMES = ("outcome", "forecast", "±", "observed")
SPREAD = ("step", "time [s]", "total [m]", "aleatoric [m]", "epistemic [m]", "observed [m]")


def outcome_rows(simulator: Simulator, example: Example) -> list[tuple[str, ...]]:
    """The rows of `OUTCOMES`: shares of the runs; ± is the standard error of so many forecasts."""
    rows: list[tuple[str, ...]] = []
    for name, (share, seen) in outcome_shares(simulator, example).items():
        error = np.sqrt(share * (1 - share) / len(example.forecast))
        rows.append((name, f"{share:.3f}", f"{error:.3f}", f"{seen:.3f}"))
    return rows


def outcome_shares(simulator: Simulator, example: Example) -> dict[str, tuple[float, float]]:
    """The shares of forecasts and of observed runs with each outcome, the goal itself first.

    As in the scores, a forecast that is not finite has none of them.
    """
    finite = np.isfinite(example.forecast).all(axis=(1, 2))
    forecast = simulator.outcomes(example.forecast, example.goal[None])
    observed = simulator.outcomes(example.observed, example.goal[None])
    return {
        name: (float((happens & finite).mean()), float(observed[name].mean()))
        for name, happens in forecast.items()
    }


def spread_rows(simulator: Simulator, example: Example) -> list[tuple[str, ...]]:
    """The rows of `SPREAD`: standard deviations of the position.

    Their squares add up, but where the epistemic variance, which is estimated without bias, is by
    chance below zero: it is told as 0.
    """
    parts = position_variance(simulator, example.forecast, example.member)
    observed = position_variance(simulator, example.observed).total
    steps = np.unique(np.linspace(0, len(example.actions), STEPS + 1).round().astype(int)[1:])
    split = example.member is not None
    each = (parts.total, parts.aleatoric, parts.epistemic, observed)
    rows: list[tuple[str, ...]] = []
    for step in steps:
        total, aleatoric, epistemic, seen = (_deviation(value[step - 1]) for value in each)
        time = f"{step * simulator.control_step:.3g}"
        rows.append((str(step), time, total, *((aleatoric, epistemic) if split else "––"), seen))
    return rows


def save(path: Path, question: Question, simulator: Simulator, example: Example) -> None:
    """Write the recording: outcomes, fans and split.

    Raises:
        BadInput: it cannot be written there.
    """
    # The panel is narrow, and the spread has a plot.
    rows = [("outcome", "forecast", "observed")]
    rows += [(name, share, seen) for name, share, _, seen in outcome_rows(simulator, example)]
    cell = question.cell
    properties = {
        "cell": cell.name,
        **asdict(cell),
        "forecast": question.title,
        "samples": len(example.forecast),
        **made_with(),
        "config": json.dumps(asdict(question.study.config), sort_keys=True),
    }
    try:
        record_forecast(path, simulator, [example], properties, README, table(rows[0], rows[1:]))
    except OSError as error:
        raise BadInput(f"--save: cannot write '{path}': {error}") from None


def _collect(study: Stored, environment: str) -> dict[str, object]:
    """The settings of the stage that observed the environment."""
    return {"environment": environment, "collect": asdict(study.config.collect)}


def _load(study: Stored, cell: Cell) -> Forecaster:
    path = study.weights(cell)
    if not study.ships(cell):
        shipped = [other.name for other in study.complete if study.ships(other)]
        raise StudyError(
            f"{study.out} ships no weights of '{cell.name}' (see publish.weights): "
            f"{nearest(cell.name, shipped)}"
        )
    checksums.check(path, study.out)
    return load_model(path)


def _observed(
    simulator: Simulator, plan: Plan, rollouts: int, noise: Seeds, progress: Progress
) -> ScenarioSet:
    s0, actions, goal = plan.s0[None], plan.actions[None], plan.goal[None]
    parts = repeat_rollouts(simulator, s0, actions, rollouts, noise, progress)
    return joined(ScenarioSet(s0, actions, goal, *part, {}) for part in parts)


def _deviation(variance: float) -> str:
    # An estimate of a small part may by chance be below zero.
    return f"{np.sqrt(max(variance, 0.0)):.4g}" if np.isfinite(variance) else "–"


def _print(console: Console, header: tuple[str, ...], rows: list[tuple[str, ...]]) -> None:
    shown = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    for index, column in enumerate(header):
        shown.add_column(column, justify="right" if index else "left", no_wrap=True)
    for row in rows:
        shown.add_row(*row)
    console.print()
    console.print(shown)
