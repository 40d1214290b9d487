"""What a fit logs."""

import pytest
import torch

from study.models.base import LOG_EVERY
from tests.helpers.models import model


def test_curves_have_a_point_every_few_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    network, points = model("full_vae"), []
    for step in range(3 * LOG_EVERY):
        monkeypatch.setattr(type(network), "global_step", step)
        monkeypatch.setattr(network, "log_dict", lambda values, at=step: points.append(at))
        network.log_curves({"loss": torch.tensor(1.0)})
    # Lightning writes at these steps: see `log_every_n_steps`.
    assert points == [LOG_EVERY - 1, 2 * LOG_EVERY - 1, 3 * LOG_EVERY - 1]
