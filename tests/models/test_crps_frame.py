"""The CRPS models of a system with a symmetry axis: the canonical frame."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from study.data.normalization import Normalization
from study.models.checkpoints import build
from study.models.crps import CrpsModel
from study.models.unroll.frame import turn
from tests.helpers.models import ACTION, HORIZON, STATE, ensemble, normalization, settings


@pytest.mark.parametrize(("name", "expected"), [("full_crps", True), ("residual_crps", False)])
def test_a_model_without_a_baseline_works_in_the_canonical_frame(name: str, expected: bool) -> None:
    """Then s_0 is not one of its inputs, since it has a direction."""
    axis = np.array([[0, 1], [1, 2]], np.int64)
    declared = replace(normalization(), turned_pairs=axis, axis=axis)

    def decoder_and_start(units: Normalization, **values: Any) -> tuple[bool, int]:
        network = build(name, units, settings(name, crps=values), None, ensemble())
        assert isinstance(network, CrpsModel)
        return network.decoder.is_canonical, network.start_size

    assert decoder_and_start(declared) == (expected, 0 if expected else STATE)
    assert decoder_and_start(normalization()) == (False, STATE)
    assert decoder_and_start(declared, canonical_frame=False) == (False, STATE)


def test_in_the_canonical_frame_the_scores_of_transitions_do_not_depend_on_direction() -> None:
    pairs = np.array([[0, 1], [2, 3]], np.int64)
    zero, one, none = np.zeros(5, np.float32), np.ones(5, np.float32), np.zeros((0, 3), np.int64)
    actions = one[:ACTION]
    units = Normalization(zero, one, zero[:ACTION], actions, one, none, pairs, pairs)
    without_latent = settings("full_crps", crps={"trajectory_latent_size": 0})
    network = build("full_crps", units, without_latent)
    assert isinstance(network, CrpsModel)
    torch.nn.init.normal_(network.decoder.skip.weight, std=0.1)
    states, angle = torch.randn(8, HORIZON + 1, 5), torch.tensor(1.0)
    turned = turn(states, torch.from_numpy(pairs), angle.cos(), angle.sin())
    both = []
    for values in (states, turned):
        torch.manual_seed(0)
        both.append(
            network.losses({"states": values, "actions": torch.ones(8, HORIZON, ACTION)}, 0)
        )
    for loss in ("loss/transitions", "loss/mean"):
        torch.testing.assert_close(both[0][loss], both[1][loss], rtol=1e-4, atol=1e-4)
