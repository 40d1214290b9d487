"""What is observed: trajectories to learn from, and scenarios with many rollouts to score on."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from study.data.storage import load_arrays, save_arrays

Floats = NDArray[np.float32]


@dataclass(frozen=True)
class Trajectories:
    """N observed trajectories, equation (1), in SI units.

    Attributes:
        states: [N, T+1, D] float32; ``states[:, 0]`` is s_0.
        actions: [N, T, A] float32; ``actions[:, t]`` leads from s_t to s_{t+1}.
        task: [N, G] float32, what was asked for in each trajectory; no model sees it.
        hidden: [N, H] float32, what acted on each trajectory and no model sees.
        facts: names, units, seeds and versions.
    """

    states: Floats
    actions: Floats
    task: Floats
    hidden: Floats
    facts: dict[str, Any]

    def __len__(self) -> int:
        return len(self.states)

    @property
    def horizon(self) -> int:
        """T, the number of control steps."""
        return self.actions.shape[1]

    def __getitem__(self, index: slice | NDArray[np.int64]) -> "Trajectories":
        """Some of the trajectories."""
        return Trajectories(
            self.states[index],
            self.actions[index],
            self.task[index],
            self.hidden[index],
            self.facts,
        )

    def save(self, path: Path) -> None:
        """Write to one safetensors file."""
        names = ("states", "actions", "task", "hidden")
        save_arrays(path, {name: getattr(self, name) for name in names}, self.facts)

    @classmethod
    def load(cls, path: Path) -> "Trajectories":
        """Read what `save` wrote.

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
        task: [S, G] float32, what is asked for in each scenario; no model sees it.
        observed: [S, K, T, D] float32, the states s_1 … s_T of K rollouts of the same s0, actions.
        hidden: [S, K, H] float32.
        facts: names, units, seeds and versions.
    """

    s0: Floats
    actions: Floats
    task: Floats
    observed: Floats
    hidden: Floats
    facts: dict[str, Any]

    def __len__(self) -> int:
        return len(self.s0)

    def __getitem__(self, index: slice | NDArray[np.int64]) -> "ScenarioSet":
        """Some of the scenarios."""
        return ScenarioSet(
            self.s0[index],
            self.actions[index],
            self.task[index],
            self.observed[index],
            self.hidden[index],
            self.facts,
        )

    def save(self, path: Path) -> None:
        """Write to one safetensors file."""
        names = ("s0", "actions", "task", "observed", "hidden")
        save_arrays(path, {name: getattr(self, name) for name in names}, self.facts)

    @classmethod
    def load(cls, path: Path) -> "ScenarioSet":
        """Read what `save` wrote.

        Raises:
            StudyError: the file is missing, is not whole, or is damaged.
        """
        arrays, facts = load_arrays(path)
        return cls(facts=facts, **arrays)
