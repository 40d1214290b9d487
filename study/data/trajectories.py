"""What is observed: trajectories to learn from, and scenarios with many rollouts to score on."""

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

    Attributes:
        states: [N, T+1, D] float32; ``states[:, 0]`` is s_0.
        actions: [N, T, A] float32; ``actions[:, t]`` leads from s_t to s_{t+1}.
        goal: [N, G] float32, what was asked for in each trajectory; no model sees it.
        unobserved: [N, H] float32, what acted on each trajectory and no model sees.
        facts: names, units, seeds and versions.
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
        """Some of the trajectories."""
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
        """Read what `save` or `save_all` wrote; what is not looked at stays in the file.

        Raises:
            StudyError: the file is missing, is not whole, or is damaged.
        """
        arrays, facts = load_arrays(path)
        return cls(facts=facts, **arrays)


@dataclass(frozen=True)
class ScenarioSet:
    """S scenarios, each observed K times: the truth that forecasts are compared with.

    Attributes:
        s0: [S, D] float32.
        actions: [S, T, A] float32.
        goal: [S, G] float32, what is asked for in each scenario; no model sees it.
        observed: [S, K, T, D] float32, the states s_1 … s_T of K rollouts of the same s0, actions.
        unobserved: [S, K, H] float32.
        facts: names, units, seeds and versions.
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
        """Some of the scenarios."""
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
        """Read what `save` or `save_all` wrote; what is not looked at stays in the file.

        Raises:
            StudyError: the file is missing, is not whole, or is damaged.
        """
        arrays, facts = load_arrays(path)
        return cls(facts=facts, **arrays)


Observed = TypeVar("Observed", Trajectories, ScenarioSet)


def save_all(path: Path, parts: Iterable[Observed], count: int) -> None:
    """Write `count` trajectories or scenarios that come part by part: the bytes of `joined` ones.

    No more than one part is in memory.
    """
    ahead = iter(parts)
    first = next(ahead)
    save_parts(path, map(_arrays, chain([first], ahead)), count, first.facts)


def joined(parts: Iterable[Observed]) -> Observed:
    """All parts in one, in memory."""
    whole = list(parts)
    arrays = [_arrays(part) for part in whole]
    one = {name: np.concatenate([each[name] for each in arrays]) for name in arrays[0]}
    return type(whole[0])(facts=whole[0].facts, **one)


def _arrays(observed: Trajectories | ScenarioSet) -> Arrays:
    """All but the facts, by name."""
    names = [field.name for field in fields(observed) if field.name != "facts"]
    return {name: getattr(observed, name) for name in names}
