"""Members that each leave a share of the data out, and residuals to the one that did."""

from dataclasses import asdict
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
import torch

from study.common.progress import Progress
from study.config.grid import Cell
from study.config.settings import Config, Ensemble
from study.data.trajectories import Trajectories
from study.examples.cart import Cart
from study.models.forecasting import forecast_members
from study.stages import collect
from study.stages import ensemble as stage
from study.training.data_module import ShuffledBatches
from study.training.inputs import load_ensemble, load_members
from study.workflow.pipeline import Pipeline

MEMBERS = 3


def test_an_order_leaves_its_share_out_and_nothing_else() -> None:
    sampler = ShuffledBatches(11, 2, seeds=[1, 2, 3], single=False, folds=True)
    batches = torch.stack(list(islice(sampler, 300)))  # [batch, order, 2]
    for order in range(MEMBERS):
        seen = set(batches[:, order].flatten().tolist())
        assert seen == {i for i in range(11) if i % MEMBERS != order}
    once = batches[:3].transpose(0, 1).flatten(1)  # an epoch has 7 of them, and 3 whole batches
    assert all(len(set(order.tolist())) == 6 for order in once)


def test_residuals_are_to_the_member_that_left_the_trajectory_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    data, out = tmp_path / "data", tmp_path / "out"
    data.mkdir()
    out.mkdir()
    sizes = {"trajectories": 20, "validation": 4, "scenarios": 2, "rollouts": 2, "horizon": 10}
    settings = {"environment": "cart", "collect": sizes | {"reduction": 10, "seed": 0}}
    collect.run(settings, {}, data, Progress())
    options = asdict(Ensemble(members=MEMBERS, cross_fit=True, hidden_size=4, steps=8))
    monkeypatch.setattr(stage, "CHUNK", 4)  # 14 trajectories: parts that begin at any fold
    given = {"first": 2, "trajectories": 14, "seed": 0, "ensemble": options}
    stage.run(given, {"data": data}, out, Progress())
    training = Trajectories.load(data / "train.safetensors")[2:16]
    members = forecast_members(load_ensemble(out), training.states[:, 0], training.actions)
    found = load_members(out)
    assert found.shape == members.shape == (14, MEMBERS, 10, len(Cart.state))
    for index in range(14):
        for member in range(MEMBERS):
            np.testing.assert_array_equal(found[index, member], members[index, index % MEMBERS])
    assert not np.allclose(members[:, 0], members[:, 1])


def test_without_folds_an_ensemble_is_what_it_was_before_there_were_any() -> None:
    cell = Cell("uav", "low", "residual_vae", 0)
    task = Pipeline(Config()).ensemble(cell)
    assert "data" not in task.settings["ensemble"]
    folds = Pipeline(Config(ensemble=Ensemble(cross_fit=True))).ensemble(cell)
    assert folds.key != task.key
