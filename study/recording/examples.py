"""The scenarios that recordings and figures show, each chosen by a stated rule."""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from study.common.arrays import Doubles, Floats, Integers
from study.data.storage import Arrays, load_arrays
from study.envs.simulator import Simulator
from study.metrics.variance import Decomposition, decompose, split
from study.recording.forecasts import Example

SHOWN = 40
"""Paths of an illustration, at most: more would only cover each other."""


def choose_examples(scores: pd.DataFrame, count: int) -> dict[str, int]:
    """Up to `count` different scenarios, each with the rule by which it was chosen."""

    def by_scenario(metric: str) -> Doubles:
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


def read_examples(path: Path, scores: pd.DataFrame, simulator: Simulator) -> list[Example]:
    """What stage evaluate picked; with an ensemble, the variance of the position in its parts."""
    arrays, facts = load_arrays(path)
    discrepancy = scores[
        (scores.metric == "mmd2") & (scores.step == -1) & (scores.dimension == "all")
    ].set_index("scenario")["value"]
    return [
        as_example(
            arrays,
            row,
            simulator,
            int(scenario),
            f"{rule}: MMD² {discrepancy[scenario]:.4f} in scenario {scenario}",
        )
        for row, (scenario, rule) in enumerate(zip(arrays["scenario"], facts["rules"], strict=True))
    ]


def as_example(
    arrays: Arrays, row: int, simulator: Simulator, scenario: int | None, rule: str
) -> Example:
    """One row of what stage evaluate keeps of its examples; with an ensemble, the spread in parts."""
    each = ("s0", "actions", "goal", "observed", "forecast", "member", "members")
    of_pick = {name: arrays[name][row] for name in each if name in arrays}
    if "member" in of_pick:
        parts = position_variance(simulator, of_pick["forecast"], of_pick["member"])
        of_pick |= {"aleatoric": parts.aleatoric, "epistemic": parts.epistemic}
    return Example(scenario=scenario, rule=rule, **of_pick)


def position_variance(
    simulator: Simulator, states: Floats, member: Integers | None = None
) -> Decomposition:
    """Variance of the position over the horizon [T] in m², summed over its axes, and its parts.

    Unbiased: of few samples a member, the members' means differ by chance too.

    Args:
        simulator: knows the position.
        states: [K, T, D].
        member: [K], the ensemble member behind each; None without an ensemble.
    """
    parts = decompose(simulator.position(states)[None], None if member is None else member[None])
    return Decomposition(*(part.sum(axis=-1) for part in vars(parts).values()))


def illustrate(
    simulator: Simulator, examples: Arrays, rules: list[str]
) -> tuple[Arrays, dict[str, Any]]:
    """Of one example, that whose outcome is most uncertain, what a picture of it needs.

    Positions from s_0 on, ``observed`` and ``forecast`` [K, T+1, 3] and ``members`` [M, T+1, 3] in
    m; ``member`` [K]; ``target`` [3]; and the variances of the position over the horizon [T] in m²,
    ``aleatoric``, ``epistemic``, and ``observed_variance``.
    """
    rule = "most uncertain outcome"
    example = rules.index(rule) if rule in rules else 0
    forecast, observed = examples["forecast"][example], examples["observed"][example]
    start = examples["s0"][example]

    def path(states: Floats) -> Floats:
        first = np.broadcast_to(start, (len(states), 1, len(start)))
        return simulator.position(np.concatenate([first, states], axis=1))

    member = examples["member"][example]
    parts = split(simulator.position(forecast)[None], member[None])
    arrays = {
        "observed": path(observed)[:SHOWN],
        "forecast": path(forecast)[:SHOWN],
        "member": member[:SHOWN],
        "members": path(examples["members"][example]),
        "target": simulator.target(examples["goal"][example]),
        "aleatoric": parts.aleatoric[0].sum(-1),
        "epistemic": parts.epistemic[0].sum(-1),
        "observed_variance": simulator.position(observed).var(axis=0, dtype=np.float64).sum(-1),
    }
    facts = {
        "rule": rules[example],
        "scenario": int(examples["scenario"][example]),
        "radius": simulator.radius,
        "control_step": simulator.control_step,
        "samples": len(forecast),
    }
    return arrays, facts
