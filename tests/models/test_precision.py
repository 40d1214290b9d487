"""Training in bfloat16: only products over all steps are rounded."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from study.models.precision import in_float32
from study.models.unroll import kernel
from tests.helpers.models import batch, model

BFLOAT16 = torch.bfloat16
RESOLUTION = 2**-8


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("full_vae", {"vae": {"teacher_forcing": "always"}}),
        ("full_vae", {"vae": {"teacher_forcing": "never"}}),
        ("probabilistic_mlp", {}),
        ("full_crps", {}),
        ("ensemble", {}),
    ],
)
@pytest.mark.parametrize("step", [0, 10**6])
def test_the_loss_is_close_and_the_recurrence_exact(
    name: str, changes: Mapping[str, Any], step: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The C functions compute in float32 alone."""
    calls: list[Any] = []
    values = []
    forward = kernel.forward

    def counted(*arguments: Any) -> None:
        calls.append(arguments)
        forward(*arguments)

    monkeypatch.setattr(kernel, "forward", counted)
    network, data = model(name, **changes), batch()
    network.on_training_data(data["states"])
    if network.data_streams:
        data = {key: torch.stack([value] * network.data_streams) for key, value in data.items()}
    for enabled in (False, True):
        calls.clear()
        torch.manual_seed(0)
        with torch.autocast("cpu", BFLOAT16, enabled, cache_enabled=False):
            loss = network.losses(data, step)["loss"]
        loss.backward()
        assert loss.dtype == torch.float32
        values.append((float(loss), len(calls)))
        gradients = [p.grad for p in network.parameters() if p.grad is not None]
        assert all(value.dtype == torch.float32 and value.isfinite().all() for value in gradients)
        assert all(
            value.dtype == torch.float32 for value in network.buffers() if value.is_floating_point()
        )
    (exact, calls_before), (rounded, calls_after) = values
    assert calls_before == calls_after
    assert exact != rounded
    np.testing.assert_allclose(rounded, exact, rtol=10 * RESOLUTION, atol=10 * RESOLUTION)


def test_in_float32() -> None:
    @in_float32
    def product(left: Tensor, right: Tensor, factor: float = 1.0) -> Tensor:
        return factor * (left @ right)

    generator = torch.Generator().manual_seed(0)
    values = torch.randn(8, 8, generator=generator)
    expected = values @ values
    with torch.autocast("cpu", BFLOAT16):
        assert (values @ values).dtype == BFLOAT16
        assert torch.equal(product(values, values), expected)
        assert torch.equal(product(values, right=values, factor=2.0), 2 * expected)
        rounded = values.to(BFLOAT16)
        assert torch.equal(product(rounded, values), product(rounded.float(), values))
    assert product(rounded, rounded).dtype == BFLOAT16  # without autocast nothing is converted
