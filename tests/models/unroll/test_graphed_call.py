"""Single transitions as a CUDA graph, played on the CPU."""

from typing import Any

import pytest
import torch
from torch import Tensor, nn

from study.models.unroll import graphs
from tests.helpers.models import batch, model
from tests.models.unroll.test_graphs import FakeCapture

STEPS = 4


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch) -> FakeCapture:
    """Networks take the path of a GPU."""
    capture = FakeCapture()
    monkeypatch.setattr(graphs, "are_used", lambda device: True)
    monkeypatch.setattr(graphs, "cuda_capture", capture)
    return capture


def trained(name: str) -> list[Tensor]:
    """The weights and buffers after a few steps, and the losses of these steps."""
    network: Any = model(name)
    data = batch()
    network.on_training_data(data["states"])
    optimizer = torch.optim.AdamW(network.parameters(), lr=0.01)
    losses = []
    for step in range(STEPS):
        torch.manual_seed(step)
        optimizer.zero_grad()
        loss = network.losses(data, step)["loss"]
        loss.backward()
        optimizer.step()
        losses.append(loss.detach())
    return [*losses, *network.state_dict().values()]


@pytest.mark.parametrize("name", ["probabilistic_mlp", "full_crps"])
def test_training_is_the_same(
    name: str, fake: FakeCapture, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = trained(name)
    assert (fake.captures, fake.replays) == (1, STEPS - 1)
    monkeypatch.setattr(graphs, "are_used", lambda device: False)
    torch.testing.assert_close(found, trained(name))


def test_the_graph_follows_a_parameter_that_moves(fake: FakeCapture) -> None:
    """As in `Module.to`, which gives the same parameter other memory."""

    class Product(nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.weight = nn.Parameter(torch.full((2,), 3.0))

        def forward(self, values: Tensor) -> tuple[Tensor]:
            return (self.weight * values,)

    product, ones = Product(), torch.ones(2)
    for use in range(3):
        assert torch.equal(graphs.call(product, ones)[0], torch.full((2,), 3.0)), use
    product.weight.data = torch.full((2,), 5.0)
    assert torch.equal(graphs.call(product, ones)[0], torch.full((2,), 5.0))
    assert fake.captures == 1


def test_only_training_in_float32_has_a_graph(fake: FakeCapture) -> None:
    network: Any = model("probabilistic_mlp")
    data = batch()
    with torch.no_grad():
        for _ in range(3):
            network.losses(data, 0)
    with torch.autocast("cpu", torch.bfloat16, cache_enabled=False):
        for _ in range(3):
            network.losses(data, 0)["loss"].backward()
    assert fake.captures == 0
