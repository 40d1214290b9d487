"""The LightningDataModule: whole trajectories in memory, in standard units, batched by index."""

from collections.abc import Iterator

import lightning as L
import numpy as np
import torch
from torch import Tensor
from torch.utils.data import DataLoader, Dataset, Sampler

from study.common.arrays import Floats
from study.common.seeds import spawn
from study.data.normalization import Normalization
from study.data.trajectories import ScenarioSet, Trajectories

Batch = dict[str, Tensor]


class InMemory(Dataset[Batch]):
    """Tensors that share their first axis; an index [...] takes from all of them at once."""

    def __init__(self, tensors: Batch) -> None:
        self.tensors = tensors

    def __len__(self) -> int:
        return len(next(iter(self.tensors.values())))

    def __getitem__(self, index: Tensor) -> Batch:
        return {name: tensor[index] for name, tensor in self.tensors.items()}


class ShuffledBatches(Sampler[Tensor]):
    """An endless stream of index batches [*orders, B]; each order shuffles the data by itself.

    Args:
        size: number of trajectories N.
        batch_size: B, at most N.
        seeds: one for each order.
        single: one order without its axis: [B].
        folds: order m leaves out every trajectory i with i mod `orders` = m.
    """

    def __init__(
        self, size: int, batch_size: int, seeds: list[int], single: bool, folds: bool = False
    ) -> None:
        self.length = size - folds * -(-size // len(seeds))  # of an order
        self.size, self.batch_size = size, min(batch_size, self.length)
        self.seeds, self.single, self.folds = seeds, single, folds

    def __iter__(self) -> Iterator[Tensor]:
        generators = [torch.Generator().manual_seed(seed) for seed in self.seeds]
        while True:
            shuffled = [torch.randperm(self.size, generator=g) for g in generators]
            if self.folds:
                shuffled = [order[order % len(shuffled) != m] for m, order in enumerate(shuffled)]
            orders = torch.stack([order[: self.length] for order in shuffled])
            for start in range(0, self.length - self.batch_size + 1, self.batch_size):
                batch = orders[:, start : start + self.batch_size]
                yield batch[0] if self.single else batch


class TrajectoryDataModule(L.LightningDataModule):
    """Batches for one model.

    A training batch holds ``states`` [B, T+1, D], ``actions`` [B, T, A] and, where given,
    ``members`` [B, M, T, D], the ensemble's forecasts, in standard units; [M, B, …] with an order
    for each of several networks that are trained side by side. The one validation batch holds
    ``s0`` [V, D], ``actions`` [V, T, A] and ``observed`` [V, L, T, D], in SI units: what a
    forecaster is given, and what its forecasts are scored against.

    Args:
        normalization: standard units.
        training: trajectories to learn from.
        validation: scenarios to score forecasts on, none of them in `training`.
        batch_size: B.
        seed: of the order of the data.
        orders: number of independent orders; None is one, without its axis.
        members: [N, M, T, D] in SI units.
        folds: each order leaves out its own share of the trajectories.
    """

    def __init__(
        self,
        normalization: Normalization,
        training: Trajectories,
        validation: ScenarioSet,
        batch_size: int,
        seed: int,
        orders: int | None = None,
        members: Floats | None = None,
        folds: bool = False,
    ) -> None:
        super().__init__()
        tensors = {
            "states": normalization.normalize_states(training.states),
            "actions": normalization.normalize_actions(training.actions),
        }
        if members is not None:
            tensors["members"] = normalization.normalize_states(members)
        self.training = InMemory(tensors)
        self.validation = InMemory(
            {
                "s0": torch.from_numpy(validation.s0),
                "actions": torch.from_numpy(validation.actions),
                "observed": torch.from_numpy(validation.observed),
            }
        )
        seeds = [int(s % np.uint64(2**63)) for s in spawn(seed, orders or 1)]
        single = orders is None
        self.sampler = ShuffledBatches(len(training), batch_size, seeds, single, folds)

    def train_dataloader(self) -> DataLoader[Batch]:
        """Endless: training ends by its number of steps, or early."""
        return DataLoader(self.training, sampler=self.sampler, batch_size=None)

    def val_dataloader(self) -> DataLoader[Batch]:
        """One batch: all validation scenarios."""
        everything = [torch.arange(len(self.validation))]
        return DataLoader(self.validation, sampler=everything, batch_size=None)
