"""Which parameters decay, and the learning rate."""

import numpy as np
import pytest
import torch
from torch import nn

from study.models.networks.linear import StackedLinear
from study.models.optimizer import adamw, one_cycle
from tests.helpers.models import model


def test_only_matrices_decay() -> None:
    linear, stacked = nn.Linear(3, 4), StackedLinear(5, 3, 4)
    parameters = [*linear.parameters(), *stacked.parameters()]
    groups = adamw(parameters, 0.1, 0.5).param_groups
    decays = {id(p): group["weight_decay"] for group in groups for p in group["params"]}
    assert [decays[id(p)] for p in parameters] == [0.5, 0.0, 0.5, 0.0]


def test_one_cycle_rises_for_a_tenth_of_the_steps_and_falls_to_zero() -> None:
    optimizer = torch.optim.SGD([nn.Parameter(torch.zeros(1))], 1.0)
    schedule = one_cycle(optimizer, 0.3, 100)
    rates = []
    for _ in range(100):
        rates.append(optimizer.param_groups[0]["lr"])
        optimizer.step()
        schedule.step()
    assert 8 <= int(np.argmax(rates)) <= 11
    np.testing.assert_allclose(max(rates), 0.3, rtol=0.01)
    assert rates[-1] < 0.001
    assert (np.diff(rates[12:]) < 0).all()


@pytest.mark.parametrize("steps", range(1, 13))
def test_one_cycle_has_a_rate_for_each_of_a_few_steps(steps: int) -> None:
    optimizer = torch.optim.SGD([nn.Parameter(torch.zeros(1))], 1.0)
    schedule = one_cycle(optimizer, 0.3, steps)
    for _ in range(steps):
        assert 0 < optimizer.param_groups[0]["lr"] <= 0.3
        optimizer.step()
        schedule.step()


@pytest.mark.parametrize("name", ["ensemble", "full_vae", "full_crps", "probabilistic_mlp"])
def test_no_bias_of_a_model_decays(name: str) -> None:
    network = model(name)
    named = {key: value for key, value in network.named_parameters() if value.requires_grad}
    groups = adamw(named.values(), 0.1, 0.5).param_groups
    decaying = {id(p) for group in groups for p in group["params"] if group["weight_decay"]}
    for key, parameter in named.items():
        assert (id(parameter) in decaying) != key.endswith("bias"), key
