"""The models in `torch.nn`, with which the benchmarks compare, compute the same."""

import pytest
import torch
from torch import Tensor

from study.models import Model
from study.models.vae import VaeModel
from tests.benchmarks.plain import plain
from tests.helpers.models import ACTION, HORIZON, STATE, batch, model


def sampled(network: Model) -> Tensor:
    generator = torch.Generator().manual_seed(0)
    s0 = torch.randn(4, STATE, generator=generator)
    actions = torch.randn(4, HORIZON, ACTION, generator=generator)
    noise = torch.randn(4, 5, HORIZON, network.noise_size, generator=generator)
    member = torch.randint(network.members_count(), (4, 5), generator=generator)
    with torch.no_grad():
        return network.sample(s0, actions, noise, member)


def heteroscedastic(name: str) -> Model:
    """A model whose decoder is not teacher forced, and whose variance depends on the state."""
    network = model(name, vae={"teacher_forcing": "never"})
    if isinstance(network, VaeModel):
        network.cvae.decoder.log_std.weight.data.normal_()
    return network


@pytest.mark.parametrize("name", ["ensemble", "residual_vae", "full_vae"])
def test_forecasts(name: str) -> None:
    network = heteroscedastic(name)
    torch.testing.assert_close(sampled(plain(network)), sampled(network), rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("name", ["residual_vae", "full_vae"])
def test_losses(name: str) -> None:
    network, data = heteroscedastic(name), batch()
    losses = []
    for variant in (network, plain(network)):
        torch.manual_seed(1)
        losses.append(variant.losses(data, 0)["loss"])
    torch.testing.assert_close(losses[1], losses[0], rtol=1e-4, atol=1e-4)
