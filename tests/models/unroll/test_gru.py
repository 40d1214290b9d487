"""The GRU of a GPU computes what the loop computes."""

from typing import Any

import pytest
import torch
from torch import Tensor

from study.models.unroll import gru as module
from study.models.unroll.gru import gru, library_gru, unrolled_gru
from tests.helpers.models import batch, model


@pytest.fixture
def on_a_gpu(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """`gru` takes the path of a GPU; the shapes of its calls."""
    calls: list[Any] = []

    def recorded(*arguments: Tensor) -> Tensor:
        calls.append(arguments[0].shape)
        return library_gru(*arguments)

    monkeypatch.setattr(module, "library_is_used", lambda device: True)
    monkeypatch.setattr(module, "library_gru", recorded)
    return calls


@pytest.mark.parametrize(("networks", "rows", "steps", "size"), [(1, 5, 7, 3), (3, 2, 1, 4)])
def test_values_and_gradients(networks: int, rows: int, steps: int, size: int) -> None:
    shapes = [(rows, steps, 3 * size), (rows, size), (size, 3 * size), (size,)]
    generator = torch.Generator().manual_seed(0)
    arguments = [
        torch.randn(networks, *shape, generator=generator, dtype=torch.float64).requires_grad_()
        for shape in shapes
    ]
    results = []
    for function in (library_gru, unrolled_gru):
        hiddens = function(*arguments)
        weighted = (hiddens * torch.arange(hiddens.numel()).view_as(hiddens).sin()).sum()
        results.append((hiddens, *torch.autograd.grad(weighted, arguments)))
    assert results[0][0].shape == (networks, rows, steps, size)
    torch.testing.assert_close(*results)


def test_products_are_not_rounded(monkeypatch: pytest.MonkeyPatch) -> None:
    """Other libraries can still read the setting."""
    monkeypatch.setattr(torch.backends.cudnn, "allow_tf32", True)
    shapes = [(1, 2, 3, 12), (1, 2, 4), (1, 4, 12), (1, 4)]
    library_gru(*(torch.ones(shape) for shape in shapes))
    assert not torch.backends.cudnn.allow_tf32
    assert torch.backends.cudnn.rnn.fp32_precision != "tf32"  # type: ignore[attr-defined]


def test_on_the_cpu_it_is_the_loop(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "library_gru", None)
    shapes = [(1, 2, 3, 12), (1, 2, 4), (1, 4, 12), (1, 4)]
    assert gru(*(torch.ones(shape) for shape in shapes)).shape == (1, 2, 3, 4)


@pytest.mark.parametrize("name", ["full_vae", "residual_vae"])
def test_the_loss_of_a_vae(name: str, request: pytest.FixtureRequest) -> None:
    """Encoder and teacher-forced decoder take the library's GRU; loss and gradients are equal."""
    network, results = model(name, vae={"teacher_forcing": "always"}), []
    for fixture in (None, "on_a_gpu"):
        calls = request.getfixturevalue(fixture) if fixture else []
        torch.manual_seed(0)
        loss = network.losses(batch(), 0)["loss"]
        parameters = [value for value in network.parameters() if value.requires_grad]
        gradients = torch.autograd.grad(loss, parameters, allow_unused=True)
        results.append((loss, *(value for value in gradients if value is not None)))
    assert len(calls) == 2
    torch.testing.assert_close(*results, rtol=1e-4, atol=1e-5)
