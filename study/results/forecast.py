"""Forecast one scenario with the weights of a results folder, without training and ``work/``.

A test scenario is sampled again from the settings of the study, to the same bits. The same holds
for the seeds of its observed rollouts and of its forecasts. With the study's number of samples the
forecasts are those that the study scored. A plan from a file gets the noise of a test scenario, so
that two plans can be compared under the same noise.
"""

import json
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from study.common.arrays import Booleans, Doubles, Integers
from study.common.errors import BadInput
from study.common.progress import Progress
from study.common.provenance import made_with
from study.common.seeds import Seeds, derive, spawn
from study.config.grid import Cell
from study.config.recorded import Recorded, recorded_of
from study.data.plan_files import Plan, read_plan
from study.data.trajectories import ScenarioSet, concatenate
from study.envs import Simulator
from study.envs.observe import real_system, repeat_rollouts, sample_planned, trajectory_seeds
from study.envs.recorded import scenarios_of, windows_of
from study.models.forecasting import example_arrays
from study.recording.examples import Example, build_example, position_variance
from study.recording.forecast import record_forecast
from study.recording.properties import table
from study.results.folder import Results, settings_of
from study.results.weights import load_forecaster
from study.workflow.pipeline import Pipeline

README = """
# A forecast

The first tab names an initial state s₀ and actions a₀ … a_{T−1}. From these, the real system was
run several times (**observed**, grey). The model forecast several trajectories (**forecast**,
blue), with the weights of the study.
"""


@dataclass(frozen=True)
class Request:
    """A request for a forecast.

    Attributes:
        results: the results folder.
        cell: the cell whose forecaster is used.
        scenario: index of the test scenario; with `file`, only its noise is used.
        file: a plan that replaces that of the scenario.
        samples: K, the number of forecasts; None for the study's number.
    """

    results: Results
    cell: Cell
    scenario: int = 0
    file: Path | None = None
    samples: int | None = None

    @property
    def title(self) -> str:
        """A name of the forecast, in a few words."""
        return f"scenario {self.scenario}" if self.file is None else self.file.name

    @property
    def description(self) -> str:
        """A sentence about the source of the actions and of the noise."""
        if self.file is None:
            return f"Scenario {self.scenario} of the test set."
        if self.recorded is not None:
            return "A plan from a file, which was never observed."
        return f"A plan from a file, with the noise of test scenario {self.scenario}."

    def real_system(self) -> tuple[Simulator, int]:
        """The simulator, with the horizon of the study, and the seed of its data."""
        return real_system(self.cell.environment, self.results.config.collect, self.recorded)

    @property
    def recorded(self) -> Recorded | None:
        """The settings of a recorded system; None for a simulator."""
        return recorded_of(self.results.config, self.cell.environment)

    def logged(self) -> ScenarioSet:
        """The test scenario of a recorded system, from its logs.

        Raises:
            BadInput: there is no such scenario, or a log cannot be read.
        """
        assert self.recorded is not None
        name, collect = self.cell.environment, self.results.config.collect
        windows = windows_of(name, self.recorded, collect, Progress()).windows["test"]
        _check_scenario(self.scenario, len(windows))
        return concatenate(scenarios_of(windows, {}))[self.scenario : self.scenario + 1]


def read_request(request: Request) -> Plan:
    """The plan to forecast, from the test scenario or from the file.

    Raises:
        BadInput: there is no such scenario, or the file cannot be used.
    """
    if request.recorded is None or request.file is not None:
        _check_scenario(request.scenario, request.results.config.collect.scenarios)
    simulator, seed = request.real_system()
    if request.file is not None:
        return read_plan(request.file, simulator)
    if request.recorded is not None:
        test = request.logged()
        return Plan(test.s0[0], test.goal[0], test.actions[0])
    seeds, _ = trajectory_seeds(derive(seed, "test"), request.scenario + 1)
    scenario, actions = sample_planned(simulator, seeds[-1:])
    return Plan(scenario.s0[0], scenario.goal[0], actions[0])


def forecast(request: Request, plan: Plan, progress: Progress) -> Example:
    """Observed rollouts and forecasts of a plan.

    Raises:
        StudyError: the weights of the cell are not published, missing or damaged.
    """
    results, cell = request.results, request.cell
    simulator, seed = request.real_system()
    forecaster = load_forecaster(results, cell, simulator)
    evaluation = Pipeline(results.config).evaluate_settings(cell)
    samples = request.samples or evaluation.evaluate.samples
    if request.recorded is not None:
        test = _unobserved(plan) if request.file is not None else request.logged()
    else:
        _, noise = trajectory_seeds(derive(seed, "test"), request.scenario + 1)
        rollouts = results.config.collect.rollouts
        test = _observe(simulator, plan, rollouts, noise[-1:], progress.part(0.0, 0.5))
    seeds = spawn(evaluation.seed, request.scenario + 1)[-1:]
    progress(0.5, "forecasting")
    forecasts = forecaster.forecast(test.s0, test.actions, samples, seeds)
    progress(1.0, "forecasting")
    arrays = example_arrays(forecaster, test, forecasts, seeds, np.array([0]))
    return build_example(arrays, 0, simulator, request.title, request.description)


def finite_samples(example: Example) -> Booleans:
    """Whether every value of a forecast is finite, [K]."""
    return np.asarray(np.isfinite(example.forecast).all(axis=(1, 2)))


def outcome_probabilities(simulator: Simulator, example: Example) -> dict[str, tuple[float, float]]:
    """Forecast and observed probability of each outcome, the goal of the environment first.

    As in the scores, a forecast that is not finite counts as none of the outcomes.
    """
    finite = finite_samples(example)
    forecasts = simulator.outcomes(example.forecast, example.goal[None])
    observed = simulator.outcomes(example.observed, example.goal[None])
    return {
        name: (float((occurs & finite).mean()), _mean(observed[name]))
        for name, occurs in forecasts.items()
    }


@dataclass(frozen=True)
class PositionStd:
    """Standard deviations of the position in m, [N] each, at N control steps.

    Attributes:
        step: the control steps.
        total: of all forecasts.
        aleatoric: the part from the noise of the system; None without an ensemble.
        epistemic: the part from the members of the ensemble; None without an ensemble.
        observed: of the observed rollouts; None without repeated ones.
    """

    step: Integers
    total: Doubles
    aleatoric: Doubles | None
    epistemic: Doubles | None
    observed: Doubles | None


def position_std(simulator: Simulator, example: Example, count: int) -> PositionStd:
    """Standard deviations of the position at `count` evenly spaced control steps.

    The squares of the parts add up to the square of the total. The estimate of the epistemic
    variance is unbiased and may be negative by chance. The standard deviation is then 0.
    """
    forecasts = position_variance(simulator, example.forecast, example.member)
    horizon = len(example.actions)
    step = np.unique(np.linspace(0, horizon, count + 1).round().astype(np.int64)[1:])

    def std(variance: Doubles) -> Doubles:
        return np.sqrt(np.maximum(variance[step - 1], 0.0))

    has_members, repeated = example.member is not None, len(example.observed) > 1
    return PositionStd(
        step,
        std(forecasts.total),
        std(forecasts.aleatoric) if has_members else None,
        std(forecasts.epistemic) if has_members else None,
        std(position_variance(simulator, example.observed).total) if repeated else None,
    )


def record(path: Path, request: Request, simulator: Simulator, example: Example) -> None:
    """Write a recording of the forecasts: outcomes, paths, and the parts of the variance.

    Raises:
        BadInput: the file cannot be written.
    """
    probabilities = outcome_probabilities(simulator, example)
    rows = [
        (name, f"{forecast:.3f}", f"{observed:.3f}")
        for name, (forecast, observed) in probabilities.items()
    ]
    outcomes = table(("outcome", "forecast", "observed"), rows)
    properties = {
        "cell": request.cell.name,
        **asdict(request.cell),
        "forecast": request.description,
        "samples": len(example.forecast),
        **made_with(),
        "config": json.dumps(settings_of(request.results.config), sort_keys=True),
    }
    try:
        record_forecast(path, simulator, [example], properties, README, outcomes)
    except OSError as error:
        raise BadInput(f"--save: cannot write '{path}': {error.strerror}") from None


def _mean(happens: Booleans) -> float:
    """The share in which an outcome happens; NaN without rollouts."""
    return float(happens.mean()) if happens.size else float("nan")


def _check_scenario(scenario: int, count: int) -> None:
    """Check that there is a test scenario of this number.

    Raises:
        BadInput: there is none.
    """
    if not 0 <= scenario < count:
        raise BadInput(f"--scenario: got {scenario}; the test set has {count}, 0 to {count - 1}")


def _unobserved(plan: Plan) -> ScenarioSet:
    """A set of one scenario that was never observed."""
    s0, actions, goal = plan.s0[None], plan.actions[None], plan.goal[None]
    observed = np.empty((1, 0, len(plan.actions), len(plan.s0)), np.float32)
    return ScenarioSet(s0, actions, goal, observed, np.empty((1, 0, 0), np.float32), {})


def _observe(
    simulator: Simulator, plan: Plan, rollouts: int, noise: Seeds, progress: Progress
) -> ScenarioSet:
    """A set of one scenario: the plan, with `rollouts` observed rollouts."""
    s0, actions, goal = plan.s0[None], plan.actions[None], plan.goal[None]
    parts = repeat_rollouts(simulator, s0, actions, rollouts, noise, progress)
    return concatenate(ScenarioSet(s0, actions, goal, *part, {}) for part in parts)
