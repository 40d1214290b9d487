"""Cross-fitting: every member leaves out a fold, and residuals are out-of-fold."""

from itertools import islice
from pathlib import Path

import numpy as np
import pytest
import torch

from study.common.progress import Progress
from study.config.model_sections import Network
from study.config.settings import Collect, Ensemble
from study.config.stage_settings import CollectSettings, EnsembleSettings, TrainingSet
from study.data.trajectories import Trajectories
from study.examples.cart import Cart
from study.models.forecasting import forecast_members
from study.stages import collect, ensemble
from study.training.data_module import ShuffledBatches
from study.training.inputs import load_ensemble, load_members

MEMBERS = 3


def test_a_data_stream_leaves_out_its_fold_and_nothing_else() -> None:
    sampler = ShuffledBatches(11, 2, seeds=[1, 2, 3], one_stream=False, cross_fit=True)
    batches = torch.stack(list(islice(sampler, 300)))  # [batch, stream, 2]
    for stream in range(MEMBERS):
        sampled = set(batches[:, stream].flatten().tolist())
        assert sampled == {i for i in range(11) if i % MEMBERS != stream}
    epoch = batches[:3].transpose(0, 1).flatten(1)  # 7 trajectories are 3 whole batches
    assert all(len(set(stream.tolist())) == 6 for stream in epoch)


def test_residuals_are_out_of_fold(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    data, out = tmp_path / "data", tmp_path / "out"
    data.mkdir()
    out.mkdir()
    sizes = Collect(trajectories=20, validation=4, scenarios=2, rollouts=2, horizon=10)
    collect.run(CollectSettings("cart", sizes), {}, data, Progress())
    # 14 trajectories in parts of 4: parts start at any fold.
    monkeypatch.setattr("study.models.forecasting.CHUNK", 4)
    settings = EnsembleSettings(
        TrainingSet(2, 14),
        seed=0,
        ensemble=Ensemble(members=MEMBERS, cross_fit=True, hidden_size=4, steps=8),
        network=Network(),
    )
    ensemble.run(settings, {"data": data}, out, Progress())
    training = Trajectories.load(data / "train.safetensors")[2:16]
    members = forecast_members(load_ensemble(out), training.states[:, 0], training.actions)
    stored = load_members(out)
    assert stored.shape == members.shape == (14, MEMBERS, 10, len(Cart.state))
    for index in range(14):
        for member in range(MEMBERS):
            np.testing.assert_array_equal(stored[index, member], members[index, index % MEMBERS])
    assert not np.allclose(members[:, 0], members[:, 1])
