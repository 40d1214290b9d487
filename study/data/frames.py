"""State components along rotating axes, expressed in a fixed frame.

A vehicle accelerates northwards when it tilts towards the north, at any heading. A network whose
inputs are roll, pitch and heading would first have to learn this rotation. So an environment may
name pairs (a, b) of state variables along axes that are rotated by an angle ψ. Learned models
work on the components in the fixed frame,

    a' = a cos ψ − b sin ψ,    b' = a sin ψ + b cos ψ

The change of frame can be inverted, since ψ is part of the state. Forecasts are changed back.
"""

from typing import Any

import numpy as np
from torch import Tensor

from study.common.arrays import Integers


def rotating_pairs_of(facts: dict[str, Any]) -> Integers:
    """Columns (a, b, ψ) of the pairs that a data set's facts name, [P, 3]."""
    columns = {variable["name"]: column for column, variable in enumerate(facts.get("state", ()))}
    pairs = [[columns[name] for name in pair] for pair in facts.get("rotating_pairs", ())]
    return np.array(pairs, dtype=np.int64).reshape(-1, 3)


def to_fixed_frame(states: Tensor, pairs: Tensor) -> Tensor:
    """Change the pairs to the fixed frame, in place.

    Args:
        states: [..., D] in SI units.
        pairs: [P, 3], see `rotating_pairs_of`.

    Returns:
        `states`.
    """
    return _rotate(states, pairs, 1)


def to_rotating_frame(states: Tensor, pairs: Tensor) -> Tensor:
    """Change the pairs back to the rotating frame, in place; see `to_fixed_frame`."""
    return _rotate(states, pairs, -1)


def _rotate(states: Tensor, pairs: Tensor, sign: int) -> Tensor:
    for first, second, angle in pairs.tolist():
        cos, sin = states[..., angle].cos(), sign * states[..., angle].sin()
        a, b = states[..., first].clone(), states[..., second].clone()
        states[..., first] = a * cos - b * sin
        states[..., second] = a * sin + b * cos
    return states
