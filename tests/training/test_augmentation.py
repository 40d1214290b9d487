"""Training batches with symmetries: transformed in SI units, reproducible, and off by default."""

from itertools import islice

import numpy as np
import pytest
import torch
from torch import Tensor

from study.common.arrays import Floats
from study.common.progress import Progress
from study.config.settings import Ensemble, Train
from study.data.normalization import Normalization
from study.data.trajectories import ScenarioSet, Trajectories, concatenate
from study.data.transformations import COPIES, SymmetryGroup
from study.envs import simulators
from study.envs.observe import observe_scenarios, observe_trajectories
from study.models.crps import CrpsModel
from study.models.rnn_ensemble import RnnEnsembleSettings
from study.training.augmentation import Augmentation
from study.training.data_module import TrajectoryDataModule
from tests.helpers.models import settings

COUNT, HORIZON, MEMBERS = 24, 20, 3


def observed(name: str) -> tuple[Trajectories, ScenarioSet]:
    simulator = simulators[name](horizon=HORIZON)
    training = concatenate(observe_trajectories(simulator, COUNT, 0, Progress()))
    return training, concatenate(observe_scenarios(simulator, 4, 2, 1, Progress()))


def module(
    name: str = "uav", symmetries: str = "all", seed: int = 0, streams: int | None = None
) -> TrajectoryDataModule:
    training, validation = observed(name)
    augmentation = Augmentation.of(symmetries, training.facts, seed)
    group = None if augmentation is None else augmentation.group
    normalization = Normalization.from_trajectories(training, group)
    return TrajectoryDataModule(
        normalization,
        training,
        validation,
        batch_size=5,
        seed=3,
        data_streams=streams,
        members=members(training),
        augmentation=augmentation,
    )


def members(training: Trajectories) -> Floats:
    """Forecasts that are the truth plus a constant in z, which no symmetry changes."""
    forecasts = training.states[:, None, 1:].repeat(MEMBERS, axis=1)
    forecasts[..., 2] += np.arange(MEMBERS, dtype=np.float32)[:, None]
    return forecasts


def batches(data: TrajectoryDataModule, count: int) -> list[dict[str, Tensor]]:
    return list(islice(iter(data.train_dataloader()), count))


@pytest.mark.parametrize("streams", [None, 2])
def test_batches_keep_their_shapes_and_members_their_trajectory(streams: int | None) -> None:
    data = module(streams=streams)
    leading = (5,) if streams is None else (streams, 5)
    assert isinstance(data.training, torch.utils.data.Dataset)
    scale = torch.from_numpy(data.training.normalization.state_scale)  # type: ignore[union-attr]
    for batch in batches(data, 6):
        assert batch["states"].shape == (*leading, HORIZON + 1, 17)
        assert batch["actions"].shape == (*leading, HORIZON, 4)
        assert batch["members"].shape == (*leading, MEMBERS, HORIZON, 17)
        error = (batch["members"] - batch["states"][..., None, 1:, :]) * scale
        constant = error[..., 2].mean(-1)
        expected = torch.arange(MEMBERS).float().expand(constant.shape)
        torch.testing.assert_close(constant, expected, atol=1e-3, rtol=0)
        error[..., 2] = 0
        assert float(error.abs().max()) < 1e-3


def test_each_batch_is_transformed_anew_and_equal_seeds_give_equal_batches() -> None:
    first, second = batches(module(), 10), batches(module(), 10)
    for one, other in zip(first, second, strict=True):
        for name in one:
            torch.testing.assert_close(one[name], other[name], rtol=0, atol=0)
    others = batches(module(seed=1), 10)
    assert not torch.equal(first[0]["states"], others[0]["states"])
    # The order of the data is the same: no transformation changes the charge of the battery.
    torch.testing.assert_close(first[0]["states"][..., 16], others[0]["states"][..., 16])
    # 4 batches are an epoch, so that a trajectory comes back with another yaw.
    charges = torch.cat([batch["states"][:, 0, 16] for batch in first])
    yaws = torch.cat([batch["states"][:, 0, 8] for batch in first])
    for charge in charges[:3]:
        same = yaws[charges == charge]
        assert len(same) > 1
        assert len(same.unique()) == len(same)


def test_the_batches_of_a_system_are_of_its_orbit() -> None:
    """Turned and mirrored trajectories are what the simulator gives, in normalised units."""
    data = module("pusher")
    training, _ = observed("pusher")
    group = SymmetryGroup.from_facts(training.facts)
    units = data.training.normalization  # type: ignore[union-attr]
    (batch,) = batches(data, 1)
    transformed = group.sample(
        np.random.default_rng(Augmentation.of("all", training.facts, 0).seed),  # type: ignore[union-attr]
        training.states[rows := next(iter(data.sampler)).numpy()][:, 0],
    )
    expected = units.normalize_states(transformed.states(training.states[rows]))
    torch.testing.assert_close(batch["states"], expected)
    expected = units.normalize_actions(transformed.actions(training.actions[rows]))
    torch.testing.assert_close(batch["actions"], expected)


def test_without_symmetries_the_batches_are_the_normalised_data() -> None:
    data, (training, _) = module(symmetries="none"), observed("uav")
    units = Normalization.from_trajectories(training)
    index = next(iter(data.sampler))
    (batch,) = batches(data, 1)
    torch.testing.assert_close(batch["states"], units.normalize_states(training.states)[index])
    assert len(data.training_states()) == COUNT


def test_a_data_set_without_a_group_is_used_as_it_is() -> None:
    training, _ = observed("uav")
    assert Augmentation.of("none", training.facts, 0) is None
    undeclared = {name: fact for name, fact in training.facts.items() if name != "symmetries"}
    assert Augmentation.of("all", undeclared, 0) is None


def test_bounds_and_the_weight_decay_are_of_the_transformed_copies() -> None:
    data, (training, _) = module(), observed("uav")
    states = data.training_states()
    assert len(states) == COPIES * COUNT
    scale = torch.from_numpy(data.training.normalization.state_scale)  # type: ignore[union-attr]
    extent = (states.amax((0, 1)) - states.amin((0, 1))) * scale
    plain = np.ptp(training.states, axis=(0, 1))
    assert (extent[:2].numpy() > plain[:2] + 10).all()  # x and y: turned and shifted
    torch.testing.assert_close(extent[16], torch.tensor(plain[16]))  # battery


def test_the_settings_of_the_three_sections() -> None:
    assert Train().symmetries == Ensemble().symmetries == "none"
    assert RnnEnsembleSettings(Ensemble(symmetries="all")).train.symmetries == "all"
    assert CrpsModel.training_options(settings("full_crps")).symmetries == "all"
    off = settings("full_crps", crps={"symmetries": "none"})
    assert CrpsModel.training_options(off).symmetries == "none"
