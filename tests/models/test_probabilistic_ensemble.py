"""Trajectory sampling: TS∞ keeps a member over the horizon, and TS1 samples one at every step."""

from typing import Any

import numpy as np
import torch
from torch import Tensor

from study.common.seeds import spawn
from study.models.forecasting import members_of_samples
from tests.helpers.models import ACTION, HORIZON, MEMBERS, STATE, model, trajectories


def identifiable(propagation: str = "trajectory") -> Any:
    """An ensemble whose member m adds exactly m to the state in each step."""
    network: Any = model(
        "probabilistic_ensemble", probabilistic_ensemble={"propagation": propagation}
    )
    for index, member in enumerate(network.member_models()):
        member.network.unit.fill_(1.0)
        member.network.variance.zero_()
        torch.nn.init.zeros_(member.network.output.weight)
        member.network.output.bias.data.fill_(index)
    return network


def members_at_work(network: Any, noise: Tensor, member: Tensor) -> Tensor:
    """The member of each step of an `identifiable` ensemble's forecasts [S, K, T]."""
    scenarios = torch.zeros(len(noise), STATE), torch.zeros(len(noise), HORIZON, ACTION)
    states = network.sample(*scenarios, noise, member)
    changes = torch.diff(states, dim=2, prepend=torch.zeros_like(states[:, :, :1]))
    return changes[..., 0].round().long()


def test_ts_infinity_keeps_its_member_and_ts1_does_not() -> None:
    torch.manual_seed(0)
    member = torch.randint(MEMBERS, (40, 10))
    noise = torch.randn(40, 10, HORIZON, STATE)
    over_horizon = members_at_work(identifiable(), noise, member)
    torch.testing.assert_close(over_horizon, member[:, :, None].expand_as(over_horizon))
    choice = torch.randn(40, 10, HORIZON, 1)
    by_step = members_at_work(identifiable("step"), torch.cat([noise, choice], -1), member)
    # The members of two steps in sequence are independent and uniform.
    pairs = torch.bincount((by_step[..., :-1] * MEMBERS + by_step[..., 1:]).flatten(), minlength=9)
    shares = pairs / pairs.sum()
    assert ((shares - 1 / 9).abs() < 5 * (1 / 9 / pairs.sum()) ** 0.5).all()
    # The normal number alone determines the member, by its tercile.
    tercile = 0.430727  # Φ⁻¹(2/3)
    expected = (choice[..., 0] > -tercile).long() + (choice[..., 0] > tercile).long()
    torch.testing.assert_close(by_step, expected)


def test_extreme_numbers_have_a_member() -> None:
    members = identifiable("step").member_of(torch.tensor([-40.0, 40.0]))
    assert members.tolist() == [0, MEMBERS - 1]


def test_the_reported_members_are_those_at_work() -> None:
    """The variance is decomposed by `members_of_samples`: it must be what the forecast used."""
    network, data, seeds = identifiable(), trajectories(5, seed=1), spawn(7, 5)
    forecasts = network.forecast(data.states[:, 0], data.actions, 8, seeds)
    changes = np.diff(forecasts, axis=2) / network.state_scale.numpy()
    member = members_of_samples(network, seeds, 8)
    assert member is not None
    expected = np.repeat(member[..., None], HORIZON - 1, 2)
    np.testing.assert_allclose(changes[..., 0], expected, atol=1e-3)
