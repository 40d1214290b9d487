"""Pairs of components along axes that turn, in axes that stand still.

What pushes a vehicle north is its tilt towards the north, whichever way it faces; told roll, pitch
and heading, a network must learn a rotation before it can learn anything else. So an environment
may name pairs (a, b) of state variables that are components along axes turned by an angle ψ, and
every learned model works on

    a' = a cos ψ − b sin ψ,    b' = a sin ψ + b cos ψ

which loses nothing: the angle itself is part of the state. Forecasts are turned back.
"""

from typing import Any

import numpy as np
from torch import Tensor

from study.common.arrays import Integers


def rotating_pairs_of(facts: dict[str, Any]) -> Integers:
    """Columns (a, b, ψ) of the pairs that the facts of a data set name, [P, 3]."""
    columns = {variable["name"]: column for column, variable in enumerate(facts.get("state", ()))}
    pairs = [[columns[name] for name in pair] for pair in facts.get("rotating_pairs", ())]
    return np.array(pairs, dtype=np.int64).reshape(-1, 3)


def turn(states: Tensor, pairs: Tensor, back: bool = False) -> Tensor:
    """`states` [..., D] in SI units, changed in place: the pairs [P, 3] turned, or turned back."""
    for first, second, angle in pairs.tolist():
        cos, sin = states[..., angle].cos(), states[..., angle].sin()
        if back:
            sin = -sin
        a, b = states[..., first].clone(), states[..., second].clone()
        states[..., first] = a * cos - b * sin
        states[..., second] = a * sin + b * cos
    return states
