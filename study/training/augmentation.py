"""Augmentation: training trajectories are transformed by the symmetries of their system."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import Dataset

from study.common.arrays import Floats
from study.common.seeds import derive
from study.data.normalization import Normalization
from study.data.trajectories import Trajectories
from study.data.transformations import COPIES, SymmetryGroup, orbit_parts

CHUNK = 1000
"""Trajectories that are transformed together."""


@dataclass(frozen=True)
class Augmentation:
    """The symmetries of a training set, and the seed of their transformations."""

    group: SymmetryGroup
    seed: int

    @classmethod
    def of(cls, symmetries: str, facts: Mapping[str, Any], seed: int) -> "Augmentation | None":
        """The augmentation by the setting `symmetries`; None if there is nothing to apply.

        Args:
            symmetries: `all` or `none`.
            facts: of the training set. They may name no symmetries.
            seed: of the fit.
        """
        group = SymmetryGroup.from_facts(facts)
        if symmetries == "none" or not group.symmetries:
            return None
        return cls(group, derive(seed, "symmetries"))


class AugmentedTrajectories(Dataset[dict[str, Tensor]]):
    """Training trajectories in SI units, which are transformed and then normalised.

    Args:
        augmentation: the symmetries. Equal seeds give equal sequences of transformations.
        normalization: units of states and actions.
        training: the training trajectories.
        members: the ensemble's forecasts [N, M, T, D] of them, SI units.
    """

    def __init__(
        self,
        augmentation: Augmentation,
        normalization: Normalization,
        training: Trajectories,
        members: Floats | None,
    ) -> None:
        self.group, self.normalization, self.training = augmentation.group, normalization, training
        self.states, self.actions = np.array(training.states), np.array(training.actions)
        self.members = None if members is None else np.array(members)
        self.generator = np.random.default_rng(augmentation.seed)

    def __len__(self) -> int:
        return len(self.states)

    def __getitem__(self, index: Tensor) -> dict[str, Tensor]:
        """The batch of the trajectories `index` [...], see `TrajectoryDataModule`.

        Each call samples new transformations, one for each trajectory of the batch.
        """
        rows, units = index.flatten().numpy(), self.normalization
        states, actions = self.states[rows], self.actions[rows]
        transformed = self.group.sample(self.generator, states[:, 0])
        batch = {
            "states": units.normalize_states(transformed.states(states)),
            "actions": units.normalize_actions(transformed.actions(actions)),
        }
        if self.members is not None:
            forecasts = transformed.states(self.members[rows])
            batch["members"] = units.normalize_states(forecasts)
        return {name: values.unflatten(0, index.shape) for name, values in batch.items()}

    def orbit_states(self) -> Tensor:
        """The states [C · N, T+1, D] of C transformed copies of each trajectory, normalised."""
        orbit = torch.empty(COPIES * len(self.states), *self.states.shape[1:])
        start = 0
        for states, _ in orbit_parts(self.training, self.group, CHUNK):
            orbit[start : start + len(states)] = self.normalization.normalize_states(states)
            start += len(states)
        return orbit
