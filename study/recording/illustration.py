"""The arrays for the paper's Fig. 1: one example, with its variance split into two parts."""

from typing import Any

import numpy as np

from study.common.arrays import Floats
from study.data.storage import Arrays
from study.envs.simulator import Simulator
from study.metrics.variance import split
from study.recording.examples import MOST_UNCERTAIN

PATHS = 40
"""Largest number of paths of an illustration. More paths would cover each other."""


def illustrate(
    simulator: Simulator, examples: Arrays, rules: list[str]
) -> tuple[Arrays, dict[str, Any]]:
    """Arrays and facts of the example with the most uncertain outcome, or of the first example.

    Args:
        simulator: computes position and target.
        examples: E examples of a forecaster with an ensemble, see
            `study.models.forecasting.example_arrays`.
        rules: the rule of each example, [E].

    Returns:
        Arrays in m and m²: the positions from s_0 on, ``observed`` and ``forecast`` [K, T+1, 3] and
        ``members`` [M, T+1, 3]; ``member`` [K]; ``target`` [3]; the variances of the position over
        the horizon, ``aleatoric``, ``epistemic`` and ``observed_variance`` [T]. Then the facts:
        rule, scenario, radius, control step and number of samples. A system without a target has
        the unit of its position as a fact, in place of m.
    """
    row = rules.index(MOST_UNCERTAIN) if MOST_UNCERTAIN in rules else 0
    forecast, observed = examples["forecast"][row], examples["observed"][row]
    member, start = examples["member"][row], examples["s0"][row]

    def path(states: Floats) -> Floats:
        first = np.broadcast_to(start, (len(states), 1, len(start)))
        return simulator.position(np.concatenate([first, states], axis=1))

    parts = split(simulator.position(forecast)[None], member[None])
    arrays = {
        "observed": path(observed)[:PATHS],
        "forecast": path(forecast)[:PATHS],
        "member": member[:PATHS],
        "members": path(examples["members"][row]),
        "target": simulator.target(examples["goal"][row]),
        "aleatoric": parts.aleatoric[0].sum(-1),
        "epistemic": parts.epistemic[0].sum(-1),
        "observed_variance": simulator.position(observed).var(axis=0, dtype=np.float64).sum(-1),
    }
    facts = {
        "rule": rules[row],
        "scenario": int(examples["scenario"][row]),
        "radius": simulator.radius,
        "control_step": simulator.control_step,
        "samples": len(forecast),
    }
    if not simulator.has_target:
        facts["position_unit"] = simulator.position_unit
    return arrays, facts
