"""Observed data: trajectories for training, and scenarios with many rollouts for scoring."""

from collections.abc import Iterable
from dataclasses import dataclass, fields
from itertools import chain
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from study.common.arrays import Floats, Integers
from study.data.storage import Arrays, load_arrays, save_arrays, save_parts


@dataclass(frozen=True)
class Trajectories:
    """N observed trajectories, equation (1), in SI units.

    The goal and the unobserved variables are no inputs of a model.

    Attributes:
        states: [N, T+1, D] float32; ``states[:, 0]`` is s_0.
        actions: [N, T, A] float32; ``actions[:, t]`` leads from s_t to s_{t+1}.
        goal: [N, G] float32, the goal of each trajectory.
        unobserved: [N, H] float32, the unobserved variables that acted on each trajectory.
        facts: JSON values: names, units, seeds and versions.
    """

    states: Floats
    actions: Floats
    goal: Floats
    unobserved: Floats
    facts: dict[str, Any]

    def __len__(self) -> int:
        return len(self.states)

    @property
    def horizon(self) -> int:
        """T, the number of control steps."""
        return self.actions.shape[1]

    def __getitem__(self, index: slice | Integers) -> "Trajectories":
        """The selected trajectories."""
        return Trajectories(
            self.states[index],
            self.actions[index],
            self.goal[index],
            self.unobserved[index],
            self.facts,
        )

    def save(self, path: Path) -> None:
        """Write to one safetensors file."""
        save_arrays(path, _arrays(self), self.facts)

    @classmethod
    def load(cls, path: Path) -> "Trajectories":
        """Read what `save` or `save_all` wrote; arrays are mapped from the file.

        Raises:
            StudyError: the file is missing, incomplete or damaged.
        """
        arrays, facts = load_arrays(path)
        return cls(facts=facts, **arrays)


@dataclass(frozen=True)
class ScenarioSet:
    """S scenarios with K observed rollouts each, in SI units, on which forecasts are scored.

    The rollouts of a scenario have the same initial state and actions.

    The goal and the unobserved variables are no inputs of a model.

    Attributes:
        s0: [S, D] float32, initial states.
        actions: [S, T, A] float32.
        goal: [S, G] float32, the goal of each scenario.
        observed: [S, K, T, D] float32, the states s_1 … s_T of K rollouts.
        unobserved: [S, K, H] float32, the unobserved variables that acted on each rollout.
        facts: JSON values: names, units, seeds and versions.
    """

    s0: Floats
    actions: Floats
    goal: Floats
    observed: Floats
    unobserved: Floats
    facts: dict[str, Any]

    def __len__(self) -> int:
        return len(self.s0)

    def __getitem__(self, index: slice | Integers) -> "ScenarioSet":
        """The selected scenarios."""
        return ScenarioSet(
            self.s0[index],
            self.actions[index],
            self.goal[index],
            self.observed[index],
            self.unobserved[index],
            self.facts,
        )

    def save(self, path: Path) -> None:
        """Write to one safetensors file."""
        save_arrays(path, _arrays(self), self.facts)

    @classmethod
    def load(cls, path: Path) -> "ScenarioSet":
        """Read what `save` or `save_all` wrote; arrays are mapped from the file.

        Raises:
            StudyError: the file is missing, incomplete or damaged.
        """
        arrays, facts = load_arrays(path)
        return cls(facts=facts, **arrays)


Observed = TypeVar("Observed", Trajectories, ScenarioSet)


def save_all(path: Path, parts: Iterable[Observed], count: int) -> None:
    """Write `count` trajectories or scenarios part by part.

    The file has the same bytes as after `save` of all parts. One part is in memory at a time.
    """
    iterator = iter(parts)
    first = next(iterator)
    save_parts(path, map(_arrays, chain([first], iterator)), count, first.facts)


def concatenate(parts: Iterable[Observed]) -> Observed:
    """Join all parts in memory. The result has the facts of the first part."""
    parts = list(parts)
    arrays = [_arrays(part) for part in parts]
    joined = {name: np.concatenate([part[name] for part in arrays]) for name in arrays[0]}
    return type(parts[0])(facts=parts[0].facts, **joined)


def _arrays(observed: Trajectories | ScenarioSet) -> Arrays:
    """All attributes but the facts, by name."""
    names = [field.name for field in fields(observed) if field.name != "facts"]
    return {name: getattr(observed, name) for name in names}
