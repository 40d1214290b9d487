"""The CRPS models: an unbiased score, a latent variable, and the loss of each phase of training."""

from typing import Any

import numpy as np
import pytest
import scoringrules
import torch
from scipy.stats import norm
from torch import Tensor

from study.models.crps import (
    ACTION_SUM_SCALE,
    TRAJECTORIES,
    CrpsModel,
    fair_score,
)
from tests.helpers.models import (
    ACTION,
    HORIZON,
    MEMBERS,
    STATE,
    batch,
    model,
)

NAMES = ["residual_crps", "full_crps"]
LATENT, NOISE = 2, 5  # sizes in `tests.helpers.models`; noise includes that of the latent


def crps(name: str, **values: Any) -> Any:
    """A small CRPS model; `values` are those of the section `crps`."""
    network = model(name, crps={"one_step_fraction": 0.8} | values)
    assert isinstance(network, CrpsModel)
    return network


@pytest.mark.parametrize("samples", [2, 3, 7])
def test_the_score_is_unbiased(samples: int) -> None:
    """The mean over many small samples against the closed form of the CRPS of a Gaussian."""
    mean, scale, observed = 0.4, 1.7, -0.9
    normal = torch.randn(200_000, samples, 1, generator=torch.Generator().manual_seed(0))
    scores = fair_score(mean + scale * normal.double(), torch.tensor([[observed]]).double())
    z = (observed - mean) / scale
    expected = scale * (z * (2 * norm.cdf(z) - 1) + 2 * norm.pdf(z) - 1 / np.sqrt(np.pi))
    error = float(scores.std()) / len(scores) ** 0.5
    assert float(scores.mean()) == pytest.approx(expected, abs=4 * error)
    assert 4 * error < 0.02


@pytest.mark.parametrize("size", [1, 4])
def test_the_score_against_scoringrules(size: int) -> None:
    generator = np.random.default_rng(0)
    forecasts, observed = generator.normal(size=(30, 6, size)), generator.normal(size=(30, size))
    found = fair_score(torch.from_numpy(forecasts), torch.from_numpy(observed))
    expected = scoringrules.es_ensemble(observed, forecasts, estimator="fair")
    np.testing.assert_allclose(found, expected, rtol=1e-6)


def test_equal_forecasts_have_a_finite_gradient() -> None:
    forecasts = torch.zeros(3, 2, 4, requires_grad=True)
    fair_score(forecasts, torch.zeros(3, 4)).sum().backward()
    assert forecasts.grad is not None
    assert forecasts.grad.isfinite().all()


@pytest.mark.parametrize("name", NAMES)
def test_the_latent_variable_is_that_of_the_trajectory(name: str) -> None:
    """Its number at the first step acts at every step; the other components act from their step."""
    network = crps(name)
    torch.manual_seed(0)
    torch.nn.init.normal_(network.decoder.stem.weight)  # initially the latent has no effect
    scenario = torch.randn(2, STATE), torch.randn(2, HORIZON, ACTION)
    noise, member = torch.randn(2, 3, HORIZON, NOISE), torch.zeros(2, 3, dtype=torch.int64)
    forecasts = network.sample(*scenario, noise, member)

    def changed_steps(step: int, component: int) -> list[bool]:
        """Steps of the forecasts that change with one number of the noise."""
        other = noise.clone()
        other[:, :, step, component] += 1.0
        differs = network.sample(*scenario, other, member) != forecasts
        return [bool(differs[:, :, t].any()) for t in range(HORIZON)]

    for component in range(NOISE):
        is_latent = component < LATENT
        assert changed_steps(0, component) == [True] * HORIZON
        later = [False] * 3 + [True] * (HORIZON - 3)
        assert changed_steps(3, component) == ([False] * HORIZON if is_latent else later)


@pytest.mark.parametrize("one_step_fraction", [0.0, 1.0])
@pytest.mark.parametrize("name", NAMES)
def test_training_lowers_the_loss_and_leaves_the_ensemble_alone(
    name: str, one_step_fraction: float
) -> None:
    network = crps(name, one_step_fraction=one_step_fraction)
    initial = {k: v.clone() for k, v in network.state_dict().items() if k.startswith("ensemble")}
    torch.manual_seed(0)
    data = batch()
    network.on_training_data(data["states"])  # rollouts keep to its range
    optimizer = torch.optim.Adam([p for p in network.parameters() if p.requires_grad], 1e-2)
    losses = []
    for _ in range(40):
        loss = network.training_step(data)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(float(loss.detach()))
    assert np.mean(losses[-5:]) < np.mean(losses[:5])
    for key, value in initial.items():
        assert torch.equal(network.state_dict()[key], value)


@pytest.mark.parametrize("name", NAMES)
def test_single_transitions_train_the_encoder(name: str) -> None:
    """Rollouts sample the latent variable from the training data, and train the decoder alone."""
    network = crps(name)
    for step, trains in ((0, True), (network.first_rollout_step(), False)):
        network.zero_grad()
        prior = network.encoder.recent.clone()
        torch.nn.init.normal_(network.decoder.stem.weight)
        network.losses(batch(), step)["loss"].backward()
        gradients = [parameter.grad for parameter in network.encoder.parameters()]
        assert all((value is not None and bool(value.any())) is trains for value in gradients)
        assert (len(network.encoder.recent) == len(prior) + 8) is trains
        assert bool(network.decoder.stem.weight.grad[:, -LATENT - STATE :].any(-1).all())


@pytest.mark.parametrize(("step", "fraction"), [(0, 1 / 31), (14, 15 / 31), (30, 1), (99, 1)])
def test_the_divergence_has_its_weight(step: int, fraction: float) -> None:
    """The weight rises over 30 of 100 steps on single transitions."""
    losses, largest = [], 7e6  # initially the divergence is small
    for weight in (0.0, largest):
        network = crps("full_crps", steps=125, trajectory_latent_weight=weight)
        torch.manual_seed(0)
        losses.append(network.losses(batch(), step))
    divergence = losses[0]["loss/kl"]
    assert divergence > 0
    torch.testing.assert_close(losses[1]["loss/kl"], divergence)
    # The other terms are means over steps and dimensions.
    expected = losses[0]["loss"] + fraction * largest * divergence / (HORIZON * STATE)
    assert expected > losses[0]["loss"] + 0.1
    torch.testing.assert_close(losses[1]["loss"], expected)


@pytest.mark.parametrize("name", NAMES)
def test_without_a_latent_variable_there_is_no_encoder(name: str) -> None:
    network = crps(name, trajectory_latent_size=0)
    assert network.encoder is None
    assert network.noise_size == NOISE - LATENT
    losses = network.losses(batch(), 0)
    assert losses["loss/kl"] == 0
    assert bool(losses["loss"].isfinite())


@pytest.mark.parametrize("action_sum", [True, False])
@pytest.mark.parametrize("name", NAMES)
def test_the_inputs_of_the_decoder(
    name: str, action_sum: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    network = crps(name, action_sum=action_sum)
    generate, observed = network.decoder.generate, []

    def recorded(s0: Tensor, inputs: Tensor, *rest: Tensor) -> Tensor:
        observed.append(inputs[0])
        return generate(s0, inputs, *rest)

    monkeypatch.setattr(network.decoder, "generate", recorded)
    data, member = batch(), torch.randint(network.members_count(), (8, 1))
    s0, actions = data["states"][:, 0], data["actions"]
    noise = torch.randn(8, 1, HORIZON, NOISE)
    network.sample(s0, actions, noise, member)
    baseline = network.baselines(s0, actions, None)[torch.arange(8), member[:, 0]]
    for t in range(HORIZON):
        expected = [actions[:, t]]
        if name == "residual_crps":
            change = (baseline[:, t + 1] - baseline[:, t]) / network.delta_std
            expected += [baseline[:, t + 1], change]
        if action_sum:
            expected.append(ACTION_SUM_SCALE * actions[:, :t].sum(1))
        expected += [network.encoder.prior(noise[:, 0, 0, :LATENT]), s0]
        torch.testing.assert_close(observed[0][:, t], torch.cat(expected, -1))


@pytest.mark.parametrize("name", NAMES)
def test_a_transition_has_the_mean_of_a_forecast_step(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On trajectories that the network forecasts with only the latent, the mean has no error."""
    network, zero = crps(name), torch.zeros(())
    torch.nn.init.normal_(network.decoder.skip.weight, std=0.1)
    network.decoder.output.weight.data.mul_(0.1)  # so that forecasts stay small
    noise, member = torch.zeros(8, 1, HORIZON, NOISE), torch.zeros(8, 1, dtype=torch.int64)
    noise[:, :, 0, :LATENT] = torch.randn(8, 1, LATENT)
    latent = network.encoder.prior(noise[:, 0, 0, :LATENT])
    monkeypatch.setattr(network, "encode", lambda *_: (latent, zero))
    s0, actions = torch.randn(8, STATE), torch.randn(8, HORIZON, ACTION)
    members = torch.randn(8, 1, HORIZON, STATE).expand(-1, network.members_count(), -1, -1)
    with torch.no_grad():
        baselines = network.baselines(s0, actions, members)
        forecasts = network.generate(s0, actions, noise, member, baselines)[:, 0]
    states = torch.cat([s0[:, None], forecasts], 1)
    data = {"states": states, "actions": actions, "members": members}
    losses = {key: float(value.detach()) for key, value in network.losses(data, 0).items()}
    assert losses["loss/mean"] < np.log(1e-8)
    terms = ("loss/transitions", "loss/correlation", "loss/mean")
    assert losses["loss"] == pytest.approx(sum(losses[term] for term in terms))


@pytest.mark.parametrize("one_step_fraction", [0.0, 1.0])
def test_all_members_are_used(one_step_fraction: float, monkeypatch: pytest.MonkeyPatch) -> None:
    network = crps("residual_crps", one_step_fraction=one_step_fraction)
    numbers = torch.arange(1.0, 1 + MEMBERS)
    condition, observed = network.condition, set()

    def recorded(baseline: Tensor, actions: Tensor) -> Tensor:
        observed.update(baseline[:, 1:].flatten().tolist())
        return condition(baseline, actions)

    monkeypatch.setattr(network, "condition", recorded)
    data = batch()
    data["members"] = numbers[None, :, None, None].expand(8, -1, HORIZON, STATE)
    network.losses(data, 0)
    assert observed == set(numbers.tolist())


def test_rollouts_start_from_a_limited_number_of_trajectories(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    network = crps("full_crps", one_step_fraction=0.0)
    generate, rows = network.generate, []

    def recorded(s0: Tensor, *rest: Tensor) -> Tensor:
        rows.append(len(s0))
        return generate(s0, *rest)

    monkeypatch.setattr(network, "generate", recorded)
    for count in (TRAJECTORIES + 3, TRAJECTORIES - 3):
        network.losses(batch(count), 0)
    assert rows == [TRAJECTORIES, TRAJECTORIES - 3]


def test_the_energy_score_has_its_weight(monkeypatch: pytest.MonkeyPatch) -> None:
    data, forecasts = batch(), torch.randn(8, 2, HORIZON, STATE)

    def loss(energy_weight: float) -> float:
        network = crps("full_crps", one_step_fraction=0.0, energy_weight=energy_weight)
        monkeypatch.setattr(network, "generate", lambda *_: forecasts)
        return float(network.losses(data, 0)["loss"])

    x, y = forecasts.movedim(1, 2), data["states"][:, 1:]
    by_dimension = fair_score(x.movedim(-1, -2)[..., None], y[..., None]).mean((0, 1))
    energy = fair_score(x / by_dimension, y / by_dimension).mean().log()
    crps_part = by_dimension.log().mean()
    assert loss(0.0) == pytest.approx(float(crps_part), abs=1e-5)
    assert loss(0.7) == pytest.approx(float(crps_part + 0.7 * energy), abs=1e-5)


def test_the_loss_is_relative(monkeypatch: pytest.MonkeyPatch) -> None:
    """Another unit of a dimension adds a constant to the loss."""
    network = crps("full_crps", one_step_fraction=0.0)
    torch.manual_seed(0)
    data, forecasts = batch(), torch.randn(8, 2, HORIZON, STATE)
    units = torch.tensor([1.0, 10.0, 0.1])

    def loss(unit: Tensor) -> float:
        monkeypatch.setattr(network, "generate", lambda *_: forecasts * unit)
        return float(network.losses(data | {"states": data["states"] * unit}, 0)["loss"])

    constant = float(units.log().mean())
    assert loss(units) == pytest.approx(loss(torch.ones(STATE)) + constant, abs=1e-4)


def test_steps_with_large_changes_are_sampled_more_often(monkeypatch: pytest.MonkeyPatch) -> None:
    network = crps("full_crps")
    states = torch.zeros(500, HORIZON + 1, STATE)
    # All states change by 3 δ at one step of the horizon, and stay constant at the other steps.
    states[:, 3:] = 3.0 * network.delta_std
    transition, conditions = network.decoder.transition, []

    def recorded(*arguments: Tensor) -> Any:
        conditions.append(arguments[1][0, :, 0])  # the first of the action
        return transition(*arguments)

    monkeypatch.setattr(network.decoder, "transition", recorded)
    actions = torch.zeros(500, HORIZON, ACTION)
    actions[:, 2] = 1.0
    torch.manual_seed(0)
    for _ in range(20):
        network.losses({"states": states, "actions": actions}, 0)
    # A weight of 1 + 3² against 1 for each of the other steps.
    expected = 10 / (10 + HORIZON - 1)
    assert float(torch.cat(conditions).detach().mean()) == pytest.approx(expected, abs=0.06)


def test_forecasts_keep_to_the_range_of_the_training_data() -> None:
    network, states = crps("full_crps"), batch()["states"]
    network.on_training_data(states)
    assert network.training_size == len(states)
    noise, member = 100 * torch.randn(8, 1, HORIZON, NOISE), torch.zeros(8, 1, dtype=torch.int64)
    forecasts = network.sample(states[:, 0], torch.randn(8, HORIZON, ACTION), noise, member)
    assert torch.equal(forecasts.amax((0, 1, 2)), states.amax((0, 1)))
    assert torch.equal(forecasts.amin((0, 1, 2)), states.amin((0, 1)))
