"""The models in `torch.nn`, with which the benchmarks compare, compute the same."""

from collections.abc import Mapping
from typing import Any

import pytest
import torch
from torch import Tensor

from study.models import Model
from study.models.networks.gaussian import GaussianDynamics
from tests.benchmarks.plain import plain
from tests.helpers.models import ACTION, HORIZON, MEMBERS, STATE, batch, model

Changes = Mapping[str, Mapping[str, Any]]

NEVER: dict[str, Any] = {"teacher_forcing": "never"}
MODELS: list[tuple[str, Changes]] = [
    ("ensemble", {}),
    ("ensemble", {"ensemble": {"teacher_forcing_fraction": 0.0}}),
    ("residual_vae", {"vae": NEVER}),
    ("full_vae", {"vae": {"teacher_forcing": "always"}}),
    ("full_vae", {"vae": NEVER | {"target": "state", "encoder": "history"}}),
    ("full_vae", {"vae": {"variance": "homoscedastic"}}),
    ("probabilistic_mlp", {}),
    ("full_crps", {"crps": {"one_step_fraction": 0.0}}),
]
VARIANTS = [
    (name, {**changes, "network": {"features": features}})
    for name, changes in MODELS
    for features in ("product", "none")
]


def sampled(network: Model) -> Tensor:
    generator = torch.Generator().manual_seed(0)
    s0 = torch.randn(4, STATE, generator=generator)
    actions = torch.randn(4, HORIZON, ACTION, generator=generator)
    noise = torch.randn(4, 5, HORIZON, network.noise_size, generator=generator)
    member = torch.randint(network.members_count(), (4, 5), generator=generator)
    with torch.no_grad():
        return network.sample(s0, actions, noise, member)


def trained(name: str, changes: Changes) -> Model:
    """A model whose variance depends on the state, whose biases are not zero and which has a range.

    Its forecasts depend on all of its weights.
    """
    network = model(name, **changes)
    network.on_training_data(3 * batch()["states"])
    for part_name, parameter in network.named_parameters():
        if parameter.requires_grad and (parameter == 0).any() and "ensemble" not in part_name:
            parameter.data.add_(0.1 * torch.randn_like(parameter))
    for part in network.modules():
        if isinstance(part, GaussianDynamics):
            part.variance.copy_(torch.tensor([0.5, 1.0, 2.0]))
    return network


@pytest.mark.parametrize(("name", "changes"), VARIANTS)
def test_forecasts(name: str, changes: Changes) -> None:
    network = trained(name, changes)
    torch.testing.assert_close(sampled(plain(network)), sampled(network), rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize(("name", "changes"), VARIANTS)
def test_losses(name: str, changes: Changes) -> None:
    """Values, and the norm of the gradient, which does not depend on the order of the weights."""
    network, data = trained(name, changes), batch()
    if name == "ensemble":
        data = {key: torch.stack([values] * MEMBERS) for key, values in data.items()}
    losses, norms = [], []
    for variant in (network, plain(network)):
        torch.manual_seed(1)
        loss = variant.training_step(data)
        loss.backward()
        losses.append(loss.detach())
        # A gate of torch has two biases where ours has one.
        gradients = [
            parameter.grad
            for key, parameter in variant.named_parameters()
            if parameter.grad is not None
            and not key.endswith(("bias_hh", "bias_hh_l0"))
            and not key.endswith(("hidden_bias", "encoder_bias"))
        ]
        norms.append(torch.nn.utils.get_total_norm(gradients))
    torch.testing.assert_close(losses[1], losses[0], rtol=1e-4, atol=1e-4)
    torch.testing.assert_close(norms[1], norms[0], rtol=1e-3, atol=1e-4)


def test_the_gradients_of_frozen_parts() -> None:
    network = plain(model("residual_vae"))
    trained_names = [name for name, value in network.named_parameters() if value.requires_grad]
    assert trained_names
    assert not any(name.startswith("ensemble") for name in trained_names)
