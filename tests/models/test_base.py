"""The contract of every forecaster: reproducible, independent scenarios, causal."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
import torch

from study.common.arrays import Floats
from study.common.errors import BadInput
from study.common.seeds import Seeds, spawn
from study.config.settings import Config, Train
from study.models import Model, models
from study.models.networks.gaussian import GaussianDynamics
from study.models.rnn_ensemble import RnnEnsemble
from tests.helpers.models import HORIZON, MEMBERS, OURS, STATE, ensemble, model, trajectories

Changes = Mapping[str, Mapping[str, Any]]

NAMES = [*OURS, "ensemble"]
VARIANTS: list[tuple[str, Changes]] = [
    ("full_vae", {"vae": {"target": "state"}}),
    ("residual_vae", {"vae": {"target": "state"}}),
    ("residual_vae", {"vae": {"encoder": "history"}}),
    ("residual_vae", {"vae": {"teacher_forcing": "scheduled"}}),
    ("full_vae", {"vae": {"decoder_output": "mean"}}),
    ("residual_vae", {"vae": {"variance": "homoscedastic"}}),
    ("ensemble", {"network": {"features": "none"}}),
    ("residual_vae", {"network": {"features": "none"}}),
    ("probabilistic_mlp", {"network": {"features": "none"}}),
    ("full_crps", {"network": {"features": "none"}}),
    ("probabilistic_ensemble", {"probabilistic_ensemble": {"propagation": "step"}}),
]
ALL: list[tuple[str, Changes]] = [(name, {}) for name in NAMES] + VARIANTS


def heteroscedastic(name: str, changes: Changes) -> Model:
    """A model whose variance depends on the past, as after training."""
    built = model(name, **changes)
    for part in built.modules():
        if isinstance(part, GaussianDynamics):
            part.variance.copy_(torch.tensor([0.5, 1.0, 2.0]))
            if part.log_std.weight.requires_grad:
                part.log_std.weight.data.normal_()
    return built


def scenarios(count: int = 5) -> tuple[Floats, Floats, Seeds]:
    data = trajectories(count, seed=1)
    return data.states[:, 0], data.actions, spawn(7, count)


def test_the_models_of_the_study_are_registered() -> None:
    assert {"residual_vae", "full_vae", "probabilistic_mlp"} <= set(models)
    assert {"residual_crps", "full_crps", "probabilistic_ensemble"} <= set(models)


@pytest.mark.parametrize(("name", "changes"), ALL)
def test_shape_and_reproducibility(name: str, changes: Changes) -> None:
    forecaster, (s0, actions, seeds) = heteroscedastic(name, changes), scenarios()
    forecasts = forecaster.forecast(s0, actions, 4, seeds)
    assert forecasts.shape == (5, 4, HORIZON, STATE)
    assert forecasts.dtype == np.float32
    assert np.isfinite(forecasts).all()
    np.testing.assert_array_equal(forecasts, forecaster.forecast(s0, actions, 4, seeds))
    other = forecaster.forecast(s0, actions, 4, spawn(8, 5))
    assert not np.allclose(forecasts, other)


@pytest.mark.parametrize(("name", "changes"), ALL)
def test_a_scenario_does_not_depend_on_the_others(name: str, changes: Changes) -> None:
    forecaster, (s0, actions, seeds) = heteroscedastic(name, changes), scenarios()
    forecasts = forecaster.forecast(s0, actions, 4, seeds)
    order = np.array([3, 0, 4, 1, 2])
    shuffled = forecaster.forecast(s0[order], actions[order], 4, seeds[order])
    np.testing.assert_allclose(shuffled, forecasts[order], rtol=1e-4, atol=1e-4)
    alone = forecaster.forecast(s0[2:3], actions[2:3], 4, seeds[2:3])
    np.testing.assert_allclose(alone, forecasts[2:3], rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize(("name", "changes"), ALL)
def test_a_forecast_is_causal(name: str, changes: Changes) -> None:
    """a_t leads from s_t to s_{t+1}: it changes ŝ_{t+1} and later states, and none before."""
    forecaster, (s0, actions, seeds) = heteroscedastic(name, changes), scenarios()
    forecasts = forecaster.forecast(s0, actions, 4, seeds)
    for step in range(HORIZON):
        other = actions.copy()
        other[:, step] += 1.0
        changed = forecaster.forecast(s0, other, 4, seeds)
        np.testing.assert_array_equal(changed[:, :, :step], forecasts[:, :, :step])
        assert not np.allclose(changed[:, :, step], forecasts[:, :, step])


@pytest.mark.parametrize("name", NAMES)
def test_parts_of_the_scenarios_give_the_same_forecasts(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    forecaster, (s0, actions, seeds) = heteroscedastic(name, {}), scenarios()
    forecasts = forecaster.forecast(s0, actions, 4, seeds)
    monkeypatch.setattr("study.models.base.MAX_ROWS", 8)
    in_parts = forecaster.forecast(s0, actions, 4, seeds)
    np.testing.assert_allclose(in_parts, forecasts, rtol=1e-4, atol=1e-4)


def test_a_sample_keeps_its_member_over_the_horizon() -> None:
    forecaster, (s0, actions, seeds) = ensemble(), scenarios()
    forecasts = forecaster.forecast(s0, actions, 50, seeds)
    inputs = forecaster.normalize(torch.from_numpy(s0), torch.from_numpy(actions))
    members = forecaster.denormalize(forecaster(*inputs)).detach().numpy()
    distance = np.abs(forecasts[:, :, None] - members[:, None]).max(axis=(3, 4))
    assert (distance.min(axis=2) < 1e-4).all()
    # Uniform over the members: a third of the samples each.
    shares = np.bincount(distance.argmin(axis=2).ravel(), minlength=MEMBERS) / 250
    assert (np.abs(shares - 1 / MEMBERS) < 0.12).all()


@pytest.mark.parametrize("name", ["residual_vae", "residual_crps", "residual_vae_ensemble"])
def test_an_ensemble_forecasts_the_same_inside_a_model(name: str) -> None:
    outer = model(name)
    torch.manual_seed(0)
    s0, actions, seeds = scenarios()
    expected = ensemble().forecast(s0, actions, 4, seeds)
    assert isinstance(outer.ensemble, RnnEnsemble)
    np.testing.assert_array_equal(outer.ensemble.forecast(s0, actions, 4, seeds), expected)
    assert not any(parameter.requires_grad for parameter in outer.ensemble.parameters())


def test_normalized_units_are_inverted() -> None:
    network, data = model("full_vae"), trajectories()
    states, actions = torch.from_numpy(data.states), torch.from_numpy(data.actions)
    normalized, normalized_actions = network.normalize(states, actions)
    for values in (normalized, normalized_actions):
        flat = values.flatten(0, 1)
        torch.testing.assert_close(flat.mean(0), torch.zeros_like(flat[0]), rtol=0, atol=1e-5)
        torch.testing.assert_close(flat.std(0, correction=0), torch.ones_like(flat[0]))
    torch.testing.assert_close(network.denormalize(normalized), states, rtol=1e-5, atol=1e-4)


def test_settings_come_from_the_sections_of_the_configuration() -> None:
    config = Config(train=Train(steps=7))
    for name in OURS:
        settings = models[name].settings_from(config, name)
        assert settings.train is config.train
    assert models["full_vae"].settings_from(config).vae is config.section("vae")


def test_a_section_that_the_configuration_lacks_is_an_error() -> None:
    @dataclass(frozen=True)
    class WrongSettings:
        trian: Train

    class WrongModel(Model[Any]):
        settings_class = WrongSettings

    with pytest.raises(BadInput, match=r"WrongModel: .* no section 'trian'; did you mean 'train'"):
        WrongModel.settings_from(Config())


def test_weight_decay_is_divided_by_the_number_of_trajectories() -> None:
    network = model("full_vae", train={"weight_decay": 30.0})
    network.on_training_data(torch.zeros(60, HORIZON + 1, STATE))
    configured: Any = network.configure_optimizers()
    matrices, others = configured["optimizer"].param_groups
    assert matrices["weight_decay"] == pytest.approx(0.5)
    assert others["weight_decay"] == 0.0
    assert configured["lr_scheduler"]["interval"] == "step"
