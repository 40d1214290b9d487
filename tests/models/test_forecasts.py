"""What holds of every forecaster: reproducible, each scenario for itself, causal, whole on disk."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from study.common.errors import StudyError
from study.common.seeds import spawn
from study.data.normalization import Normalization
from study.models import Model, models
from study.models.checkpoints import build, load_model, save_model
from study.models.networks.gaussian_decoder import GaussianDecoder
from study.models.rnn_ensemble import Ensemble
from tests.helpers.models import ACTION, HORIZON, STATE, model, settings, trajectories

NAMES = [
    "residual_vae",
    "full_vae",
    "probabilistic_mlp",
    "ensemble",
    "residual_crps",
    "full_crps",
    "full_vae_ensemble",
    "residual_vae_ensemble",
    "probabilistic_ensemble",
]
VARIANTS: list[tuple[str, dict[str, Any]]] = [
    ("full_vae", {"output": "direct"}),
    ("residual_vae", {"output": "direct"}),
    ("residual_vae", {"encoder": "history"}),
    ("residual_vae", {"feeding": "schedule"}),
    ("full_vae", {"forecast": "mean"}),
    ("residual_vae", {"width": "fixed"}),
    ("probabilistic_ensemble", {"propagation": "step"}),
]
EVERY: list[tuple[str, dict[str, Any]]] = [(name, {}) for name in NAMES] + VARIANTS


def varied(name: str, **variant: Any) -> Model:
    """A model whose decoder's noise varies with the past, as it does after training."""
    made = model(name, **variant)
    for part in made.modules():
        if isinstance(part, GaussianDecoder):
            part.variance.copy_(torch.tensor([0.5, 1.0, 2.0]))
            if part.width.weight.requires_grad:
                part.width.weight.data.normal_()
    return made


def given(count: int = 5) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    data = trajectories(count, seed=1)
    return data.states[:, 0], data.actions, spawn(7, count)


def test_the_papers_models_are_registered() -> None:
    assert {"residual_vae", "full_vae", "probabilistic_mlp"} <= set(models)


@pytest.mark.parametrize(("name", "variant"), EVERY)
def test_shape_and_reproducibility(name: str, variant: dict[str, Any]) -> None:
    forecaster, (s0, actions, seeds) = varied(name, **variant), given()
    forecasts = forecaster.forecast(s0, actions, 4, seeds)
    assert forecasts.shape == (5, 4, HORIZON, STATE)
    assert forecasts.dtype == np.float32
    assert np.isfinite(forecasts).all()
    np.testing.assert_array_equal(forecasts, forecaster.forecast(s0, actions, 4, seeds))
    other = forecaster.forecast(s0, actions, 4, spawn(8, 5))
    assert not np.allclose(forecasts, other)


@pytest.mark.parametrize(("name", "variant"), EVERY)
def test_a_scenario_does_not_know_of_the_others(name: str, variant: dict[str, Any]) -> None:
    forecaster, (s0, actions, seeds) = varied(name, **variant), given()
    forecasts = forecaster.forecast(s0, actions, 4, seeds)
    order = np.array([3, 0, 4, 1, 2])
    shuffled = forecaster.forecast(s0[order], actions[order], 4, seeds[order])
    np.testing.assert_allclose(shuffled, forecasts[order], rtol=1e-4, atol=1e-4)
    alone = forecaster.forecast(s0[2:3], actions[2:3], 4, seeds[2:3])
    np.testing.assert_allclose(alone, forecasts[2:3], rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize(("name", "variant"), EVERY)
def test_a_forecast_is_causal(name: str, variant: dict[str, Any]) -> None:
    """a_t leads from s_t to s_{t+1}: it changes ŝ_{t+1} and later ones, and none before."""
    forecaster, (s0, actions, seeds) = varied(name, **variant), given()
    forecasts = forecaster.forecast(s0, actions, 4, seeds)
    for step in range(HORIZON):
        other = actions.copy()
        other[:, step] += 1.0
        changed = forecaster.forecast(s0, other, 4, seeds)
        np.testing.assert_array_equal(changed[:, :, :step], forecasts[:, :, :step])
        assert not np.allclose(changed[:, :, step], forecasts[:, :, step])


@pytest.mark.parametrize(("name", "variant"), EVERY)
def test_saved_and_loaded_it_is_the_same(
    name: str, variant: dict[str, Any], tmp_path: Path
) -> None:
    forecaster, (s0, actions, seeds) = varied(name, **variant), given()
    path = tmp_path / "model.safetensors"
    save_model(forecaster, name, path, beta=0.1)
    again = load_model(path).forecast(s0, actions, 4, seeds)
    np.testing.assert_array_equal(again, forecaster.forecast(s0, actions, 4, seeds))
    first = path.read_bytes()
    save_model(forecaster, name, path, beta=0.1)
    assert path.read_bytes() == first


def test_a_member_is_kept_over_the_horizon() -> None:
    forecaster, (s0, actions, seeds) = varied("ensemble"), given()
    forecasts = forecaster.forecast(s0, actions, 50, seeds)
    standard = forecaster.normalize(torch.from_numpy(s0), torch.from_numpy(actions))
    members = forecaster.denormalize(forecaster(*standard))
    distance = np.abs(forecasts[:, :, None] - members.detach().numpy()[:, None]).max(axis=(3, 4))
    assert (distance.min(axis=2) < 1e-4).all()
    # Uniform over the three members: each is drawn by about a third of the samples.
    shares = np.bincount(distance.argmin(axis=2).ravel(), minlength=3) / 250
    assert (np.abs(shares - 1 / 3) < 0.12).all()


@pytest.mark.parametrize("name", ["residual_vae", "residual_crps"])
def test_an_ensemble_forecasts_in_a_model_as_it_does_alone(name: str) -> None:
    ensemble: Any = varied("ensemble")
    for index, parameter in enumerate(ensemble.parameters()):
        torch.nn.init.normal_(parameter, generator=torch.Generator().manual_seed(index))
    alone = ensemble.forecast(*given()[:2], 4, given()[2])
    inner = build(name, Normalization.of(trajectories()), settings(), 0.1, ensemble).ensemble
    assert isinstance(inner, Ensemble)
    np.testing.assert_array_equal(inner.forecast(*given()[:2], 4, given()[2]), alone)


def test_batches_have_the_sizes_of_the_data() -> None:
    forecaster = varied("probabilistic_mlp")
    assert (forecaster.state_size, forecaster.action_size) == (STATE, ACTION)


def test_weights_of_another_version_are_told(tmp_path: Path) -> None:
    path = tmp_path / "model.safetensors"
    network = model("full_vae")
    del network.settings["vae"]["width"]
    save_model(network, "full_vae", path, beta=0.1)
    with pytest.raises(StudyError, match="of another version of the study"):
        load_model(path)
