"""The distance that a recording of training data plots: to the target, or from the start."""

from dataclasses import dataclass

import numpy as np

from study.common.arrays import Doubles
from study.data.trajectories import Trajectories
from study.envs.simulator import Simulator
from study.recording.streams import finite


@dataclass(frozen=True)
class Distance:
    """The distance of each trajectory at each step.

    Attributes:
        values: [N, T+1]; NaN if not finite.
        extreme: [N], the least distance to the target, or the largest from the start.
        title: of the plot, with the unit.
        column: of the table of trajectories.
        rules: of the selected trajectories with the smallest, the median and the largest extreme:
            title of the tab, and the rule as a predicate.
    """

    values: Doubles
    extreme: Doubles
    title: str
    column: str
    rules: tuple[tuple[str, str], ...]

    @classmethod
    def of(cls, simulator: Simulator, trajectories: Trajectories) -> "Distance":
        """The distance of trajectories in metres; without a position, in standard deviations."""
        if simulator.has_target:
            return _to_target(simulator, trajectories)
        return _from_start(simulator, trajectories)


def _to_target(simulator: Simulator, trajectories: Trajectories) -> Distance:
    positions = simulator.position(trajectories.states).astype(np.float32)
    targets = np.asarray(simulator.target(trajectories.goal), dtype=np.float32)
    values = finite(np.linalg.norm(positions - targets[:, None], axis=-1))
    # Infinite if no distance is finite.
    least = np.nanmin(np.where(np.isnan(values), np.inf, values), axis=1)
    rules = (
        ("Closest", "comes closest to its target"),
        ("Median", "comes as close to its target as the median"),
        ("Farthest", "stays farthest from its target"),
    )
    return Distance(values, least, "Distance to the target [m]", "closest [m]", rules)


def _from_start(simulator: Simulator, trajectories: Trajectories) -> Distance:
    states = trajectories.states
    if simulator.has_position:
        moved, unit = simulator.position(states), simulator.position_unit
    else:
        scale = states.std(axis=(0, 1), dtype=np.float64)
        moved, unit = (states / np.where(scale > 0, scale, 1.0)).astype(np.float32), "sd"
    values = finite(np.linalg.norm(moved - moved[:, :1], axis=-1))
    largest = np.nanmax(np.where(np.isnan(values), -np.inf, values), axis=1)
    rules = (
        ("Smallest move", "moves least from its start"),
        ("Median move", "moves as far from its start as the median"),
        ("Largest move", "moves farthest from its start"),
    )
    return Distance(values, largest, f"Distance from the start [{unit}]", f"moves [{unit}]", rules)
