"""The LightningDataModule: whole trajectories in memory, normalised, batched by index."""

import copy
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
from study.training.augmentation import Augmentation, AugmentedTrajectories

Batch = dict[str, Tensor]


class InMemory(Dataset[Batch]):
    """Tensors with a common first axis. An index tensor [...] selects from all of them."""

    def __init__(self, tensors: Batch) -> None:
        self.tensors = tensors

    def __len__(self) -> int:
        return len(next(iter(self.tensors.values())))

    def __getitem__(self, index: Tensor) -> Batch:
        return {name: tensor[index.to(tensor.device)] for name, tensor in self.tensors.items()}

    def to(self, device: torch.device) -> "InMemory":
        """The same data set on a device. Its batches are made there."""
        return InMemory({name: tensor.to(device) for name, tensor in self.tensors.items()})

    def size(self) -> int:
        """Bytes."""
        return sum(tensor.nbytes for tensor in self.tensors.values())


def free_memory(device: torch.device) -> int:
    """Bytes that a data set may take on a GPU: half of what is free. 0 on any other device."""
    return torch.cuda.mem_get_info(device)[0] // 2 if device.type == "cuda" else 0


class ShuffledBatches(Sampler[Tensor]):
    """Endless index batches, shuffled anew in every epoch.

    Each of several networks that are trained in parallel has a separate data stream: the same data
    in another order.

    Args:
        size: number of trajectories N.
        batch_size: B, at most the length of an epoch.
        seeds: one for each data stream.
        one_stream: batches are [B] and not [streams, B]. There must be one seed.
        cross_fit: stream m leaves out its fold, every trajectory i with i mod `len(seeds)` = m.
    """

    def __init__(
        self,
        size: int,
        batch_size: int,
        seeds: list[int],
        one_stream: bool,
        cross_fit: bool = False,
    ) -> None:
        largest_fold = -(-size // len(seeds))
        self.epoch_length = size - largest_fold if cross_fit else size
        self.size, self.batch_size = size, min(batch_size, self.epoch_length)
        self.seeds, self.one_stream, self.cross_fit = seeds, one_stream, cross_fit

    def __iter__(self) -> Iterator[Tensor]:
        generators = [torch.Generator().manual_seed(seed) for seed in self.seeds]
        length, size = self.epoch_length, self.batch_size
        while True:
            orders = [torch.randperm(self.size, generator=g) for g in generators]
            if self.cross_fit:
                orders = [order[order % len(orders) != m] for m, order in enumerate(orders)]
            epoch = torch.stack([order[:length] for order in orders])
            for start in range(0, length - size + 1, size):
                batch = epoch[:, start : start + size]
                yield batch[0] if self.one_stream else batch


class TrajectoryDataModule(L.LightningDataModule):
    """Batches for one model.

    The data set lies on the GPU on which a model is fitted, if it fits there.

    With symmetries, the module keeps the trajectories in SI units, on the CPU. Every trajectory of
    every batch is transformed anew, together with its `members`, and then normalised.

    A training batch holds ``states`` [B, T+1, D], ``actions`` [B, T, A] and, for a residual model,
    ``members`` [B, M, T, D], the ensemble's forecasts. All are normalised. With data streams for
    networks that are trained in parallel, each tensor has a leading axis of streams.

    The one validation batch holds ``s0`` [V, D], ``actions`` [V, T, A] and ``observed``
    [V, L, T, D] in SI units: the inputs of a forecaster, and the rollouts that score its forecasts.

    Args:
        normalization: of states and actions.
        training: trajectories for training.
        validation: scenarios for validation, disjoint from `training`.
        batch_size: B.
        seed: of the order of the data.
        data_streams: number of data streams; None for one, without its axis.
        members: the ensemble's forecasts [N, M, T, D] of the training trajectories in SI units.
        cross_fit: each data stream leaves out its fold.
        augmentation: the symmetries of the training trajectories; None for none.
    """

    def __init__(
        self,
        normalization: Normalization,
        training: Trajectories,
        validation: ScenarioSet,
        batch_size: int,
        seed: int,
        data_streams: int | None = None,
        members: Floats | None = None,
        cross_fit: bool = False,
        augmentation: Augmentation | None = None,
    ) -> None:
        super().__init__()
        self.training: InMemory | AugmentedTrajectories
        if augmentation is not None:
            self.training = AugmentedTrajectories(augmentation, normalization, training, members)
        else:
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
        seeds = [int(s % np.uint64(2**63)) for s in spawn(seed, data_streams or 1)]
        one_stream = data_streams is None
        self.sampler = ShuffledBatches(len(training), batch_size, seeds, one_stream, cross_fit)

    def training_states(self) -> Tensor:
        """The training states [N, T+1, D], normalised.

        With symmetries, N counts the transformed copies of each trajectory.
        """
        if isinstance(self.training, AugmentedTrajectories):
            return self.training.orbit_states()
        return self.training.tensors["states"]

    def first_batch(self) -> Batch:
        """The first training batch, without an effect on those that follow."""
        training = copy.copy(self.training)
        if isinstance(training, AugmentedTrajectories):
            training.generator = copy.deepcopy(training.generator)
        return training[next(iter(self.sampler))]

    def train_dataloader(self) -> DataLoader[Batch]:
        """Endless batches; the trainer stops after `FitOptions.steps` steps, or early.

        The order of the data is the same on every device.
        """
        training, trainer = self.training, self.trainer
        device = torch.device("cpu") if trainer is None else trainer.strategy.root_device
        if isinstance(training, InMemory) and training.size() < free_memory(device):
            training = training.to(device)
        return DataLoader(training, sampler=self.sampler, batch_size=None)

    def val_dataloader(self) -> DataLoader[Batch]:
        """One batch of all validation scenarios."""
        all_scenarios = [torch.arange(len(self.validation))]
        return DataLoader(self.validation, sampler=all_scenarios, batch_size=None)
