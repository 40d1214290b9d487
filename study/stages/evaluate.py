"""Stage evaluate: forecast the test scenarios and score the forecasts.

Every forecaster, the simulator included, goes through the same lines. Writes ``scores.parquet``
(tidy, see `study.metrics.scores`) and ``picks.safetensors``: the forecasts of a few scenarios,
chosen by stated rules, for the recordings; and, of a forecaster with an ensemble,
``illustration.safetensors``: the positions and variances that Fig. 1 of the paper shows.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from study.common.progress import Progress
from study.common.seeds import Seeds, spawn
from study.data.storage import Arrays, save_arrays
from study.data.trajectories import Floats, ScenarioSet
from study.envs import Simulator, simulators
from study.metrics.tables.scores import Outcomes, score
from study.metrics.variance import split
from study.models import Forecaster, Model
from study.models.base import draw_members
from study.models.checkpoints import load_model
from study.models.model_ensemble import EnsembleOf
from study.models.rnn_ensemble import Ensemble
from study.stages.collect import read_kernel, repeat_rollouts
from study.stages.ensemble import forecast_members

SHOWN = 40
"""Paths of an illustration, at most: more would only cover each other."""


@dataclass(frozen=True)
class Oracle:
    """The simulator itself as a forecaster: it re-runs s_0 and the actions with other noise."""

    simulator: Simulator

    def forecast(self, s0: Floats, actions: Floats, samples: int, seeds: Seeds) -> Floats:
        """See `Forecaster.forecast`."""
        parts = repeat_rollouts(self.simulator, s0, actions, samples, seeds, Progress())
        return np.concatenate([states for states, _ in parts])


def run(settings: dict[str, Any], inputs: dict[str, Path], out: Path, progress: Progress) -> None:
    """See the module."""
    evaluate, samples = settings["evaluate"], settings["evaluate"]["samples"]
    test = ScenarioSet.load(inputs["data"] / "test.safetensors")
    simulator = simulators[settings["environment"]](horizon=test.actions.shape[1])
    forecaster = load_forecaster(settings["model"], simulator, inputs)
    names, scale, bandwidth = read_kernel(inputs["data"])
    seeds = spawn(settings["seed"], len(test))
    progress(0.01, "forecasting")
    forecasts = forecast_in_parts(forecaster, test, samples, seeds, progress.part(0.01, 0.5))
    member = members_of(forecaster, seeds, samples)
    scores = score(
        forecasts,
        test.observed,
        Outcomes(
            simulator.outcomes(forecasts, test.task[:, None]),
            simulator.outcomes(test.observed, test.task[:, None]),
            simulator.reached(forecasts, test.task[:, None]),
            simulator.reached(test.observed, test.task[:, None]),
        ),
        scale,
        bandwidth * evaluate["bandwidth"],
        names,
        member,
        ruler=isinstance(forecaster, Oracle),
        progress=lambda share: progress.part(0.5, 1.0)(share, "scoring"),
    )
    scores.to_parquet(out / "scores.parquet", index=False)
    chosen = pick_scenarios(scores, evaluate["picks"])
    arrays = picked(forecaster, test, forecasts, seeds, np.array(list(chosen.values())))
    save_arrays(out / "picks.safetensors", arrays, {"rules": list(chosen)})
    if "members" in arrays:
        illustration, facts = illustrate(simulator, arrays, list(chosen))
        save_arrays(out / "illustration.safetensors", illustration, facts)


def illustrate(
    simulator: Simulator, picks: Arrays, rules: list[str]
) -> tuple[Arrays, dict[str, Any]]:
    """Of one pick, that whose outcome is most uncertain, what a picture of it needs.

    Positions from s_0 on, ``observed`` and ``forecast`` [K, T+1, 3] and ``members`` [M, T+1, 3] in
    m; ``member`` [K]; ``target`` [3]; and the variances of the position over the horizon [T] in m²,
    ``aleatoric``, ``epistemic``, and ``observed_variance``.
    """
    rule = "most uncertain outcome"
    pick = rules.index(rule) if rule in rules else 0
    forecast, observed = picks["forecast"][pick], picks["observed"][pick]
    start = picks["s0"][pick]

    def path(states: Floats) -> Floats:
        first = np.broadcast_to(start, (len(states), 1, len(start)))
        return simulator.position(np.concatenate([first, states], axis=1))

    member = picks["member"][pick]
    parts = split(simulator.position(forecast)[None], member[None])
    arrays = {
        "observed": path(observed)[:SHOWN],
        "forecast": path(forecast)[:SHOWN],
        "member": member[:SHOWN],
        "members": path(picks["members"][pick]),
        "target": simulator.target(picks["task"][pick]),
        "aleatoric": parts.aleatoric[0].sum(-1),
        "epistemic": parts.epistemic[0].sum(-1),
        "observed_variance": simulator.position(observed).var(axis=0, dtype=np.float64).sum(-1),
    }
    facts = {
        "rule": rules[pick],
        "scenario": int(picks["scenario"][pick]),
        "radius": simulator.radius,
        "control_step": simulator.control_step,
        "samples": len(forecast),
    }
    return arrays, facts


def load_forecaster(model: str, simulator: Simulator, inputs: dict[str, Path]) -> Forecaster:
    """The cell's forecaster: the oracle, the ensemble alone, or a fitted model."""
    if model == "oracle":
        return Oracle(simulator)
    if model == "ensemble":
        return load_model(inputs["ensemble"] / "ensemble.safetensors")
    return load_model(inputs["trained"] / "model.safetensors")


def forecast_in_parts(
    forecaster: Forecaster, test: ScenarioSet, samples: int, seeds: Seeds, progress: Progress
) -> Floats:
    """`forecast` of all scenarios [S, K, T, D], a tenth of them at a time to tell progress."""
    parts = np.array_split(np.arange(len(test)), min(10, len(test)))
    forecasts = []
    for done, part in enumerate(parts, start=1):
        forecasts.append(
            forecaster.forecast(test.s0[part], test.actions[part], samples, seeds[part])
        )
        progress(done / len(parts), "forecasting")
    return np.concatenate(forecasts)


def pick_scenarios(scores: pd.DataFrame, count: int) -> dict[str, int]:
    """Up to `count` different scenarios, each with the rule by which it was chosen."""

    def by_scenario(metric: str) -> NDArray[np.float64]:
        rows = scores[(scores.metric == metric) & (scores.scenario >= 0) & (scores.step == -1)]
        rows = rows[rows.dimension == "all"]
        return np.asarray(rows.sort_values("scenario").value)

    discrepancy = np.nan_to_num(by_scenario("mmd2"), nan=np.inf)
    forecast, observed = by_scenario("forecast_probability"), by_scenario("observed_probability")
    order = np.argsort(discrepancy, kind="stable")
    rules = {
        "median MMD²": order[len(order) // 2],
        "lowest MMD²": order[0],
        "highest MMD²": order[-1],
        "most uncertain outcome": np.argmin(np.abs(observed - 0.5)),
        "forecast most too hopeful": np.argmax(forecast - observed),
        "forecast most too doubtful": np.argmax(observed - forecast),
        "90 % quantile of MMD²": order[int(0.9 * (len(order) - 1))],
        "10 % quantile of MMD²": order[int(0.1 * (len(order) - 1))],
    }
    rules |= {f"scenario {index}": index for index in range(len(order))}
    chosen: dict[str, int] = {}
    for rule, index in rules.items():
        if len(chosen) < count and int(index) not in chosen.values():
            chosen[rule] = int(index)
    return chosen


def picked(
    forecaster: Forecaster,
    test: ScenarioSet,
    forecasts: Floats,
    seeds: Seeds,
    index: NDArray[np.int64],
) -> Arrays:
    """All that a recording shows of the scenarios `index` [P]."""
    arrays: Arrays = {
        "scenario": index,
        "s0": test.s0[index],
        "actions": test.actions[index],
        "task": test.task[index],
        "observed": test.observed[index],
        "forecast": forecasts[index],
    }
    ensemble, member = ensemble_of(forecaster), members_of(forecaster, seeds, forecasts.shape[1])
    if ensemble is not None and member is not None:
        arrays["member"] = member[index]
        arrays["members"] = forecast_members(ensemble, test.s0[index], test.actions[index])
    return arrays


def ensemble_of(forecaster: Forecaster) -> Ensemble | EnsembleOf | None:
    """The ensemble that a forecaster is, or has."""
    if isinstance(forecaster, Ensemble | EnsembleOf):
        return forecaster
    inner = getattr(forecaster, "ensemble", None) if isinstance(forecaster, Model) else None
    return inner if isinstance(inner, Ensemble) else None


def members_of(forecaster: Forecaster, seeds: Seeds, samples: int) -> NDArray[np.int64] | None:
    """The member behind each sample, [S, K]; None where there is but one."""
    count = forecaster.members_count() if isinstance(forecaster, Model) else 1
    return draw_members(seeds, samples, count) if count > 1 else None
