"""What the benchmarks compare with, the models in `torch.nn`, computes the same."""

import pytest
import torch
from torch import Tensor

from study.models import Model
from study.models.vae import Vae
from tests.benchmarks.plain import plain
from tests.helpers.models import ACTION, HORIZON, STATE, model


def sampled(network: Model) -> Tensor:
    generator = torch.Generator().manual_seed(0)
    s0 = torch.randn(4, STATE, generator=generator)
    actions = torch.randn(4, HORIZON, ACTION, generator=generator)
    noise = torch.randn(4, 5, HORIZON, network.noise_size, generator=generator)
    member = torch.randint(network.members_count(), (4, 5), generator=generator)
    with torch.no_grad():
        return network.sample(s0, actions, noise, member)


@pytest.mark.parametrize("name", ["ensemble", "residual_vae", "full_vae"])
def test_forecasts(name: str) -> None:
    network = model(name, feeding="free")
    if isinstance(network, Vae):
        network.cvae.decode.width.weight.data.normal_()
    torch.testing.assert_close(sampled(plain(network)), sampled(network), rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("name", ["residual_vae", "full_vae"])
def test_losses(name: str) -> None:
    network = model(name, feeding="free")
    assert isinstance(network, Vae)
    network.cvae.decode.width.weight.data.normal_()
    batch = {"states": torch.randn(6, HORIZON + 1, STATE), "actions": torch.randn(6, HORIZON, 2)}
    found = []
    for each in (network, plain(network)):
        torch.manual_seed(1)
        found.append(each.losses(batch, 0)["loss"])
    torch.testing.assert_close(found[1], found[0], rtol=1e-4, atol=1e-4)
