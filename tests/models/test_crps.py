"""The generators beyond the paper: a score without bias, and noise that lasts."""

from dataclasses import asdict
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import scoringrules
import torch
from scipy.stats import norm

from study.config.grid import Cell
from study.config.settings import Config, Crps
from study.models.crps import TRAJECTORIES, CrpsGenerator, fair_score, two_cycles
from study.models.networks.likelihood import logarithmic_score
from study.workflow.pipeline import Pipeline
from tests.helpers.models import ACTION, HORIZON, STATE, model

NAMES = ["residual_crps", "full_crps"]
LASTING, NOISE = 2, 5


def generator(name: str, **crps: Any) -> CrpsGenerator:
    made = model(name, crps=crps)
    assert isinstance(made, CrpsGenerator)
    return made


@pytest.mark.parametrize("samples", [2, 3, 7])
def test_the_score_has_no_bias(samples: int) -> None:
    """Against the closed form of the CRPS of a normal: the mean over many small samples."""
    mean, scale, observed = 0.4, 1.7, -0.9
    draws = torch.randn(200_000, samples, 1, generator=torch.Generator().manual_seed(0))
    scores = fair_score(mean + scale * draws.double(), torch.tensor([[observed]]).double())
    z = (observed - mean) / scale
    expected = scale * (z * (2 * norm.cdf(z) - 1) + 2 * norm.pdf(z) - 1 / np.sqrt(np.pi))
    error = float(scores.std()) / len(scores) ** 0.5
    assert float(scores.mean()) == pytest.approx(expected, abs=4 * error)
    assert 4 * error < 0.02


@pytest.mark.parametrize("size", [1, 4])
def test_the_score_against_scoringrules(size: int) -> None:
    draws = np.random.default_rng(0)
    forecasts, observed = draws.normal(size=(30, 6, size)), draws.normal(size=(30, size))
    found = fair_score(torch.from_numpy(forecasts), torch.from_numpy(observed))
    expected = scoringrules.es_ensemble(observed, forecasts, estimator="fair")
    np.testing.assert_allclose(found, expected, rtol=1e-6)


def test_forecasts_that_coincide_have_a_derivative() -> None:
    forecasts = torch.zeros(3, 2, 4, requires_grad=True)
    fair_score(forecasts, torch.zeros(3, 4)).sum().backward()
    assert forecasts.grad is not None
    assert forecasts.grad.isfinite().all()


@pytest.mark.parametrize("name", NAMES)
def test_the_lasting_noise_lasts(name: str) -> None:
    """Its first value serves for every step; the other components are drawn at each."""
    network = generator(name)
    torch.manual_seed(0)
    torch.nn.init.normal_(network.decode.first.weight)  # it begins without the lasting noise
    given = torch.randn(2, STATE), torch.randn(2, HORIZON, ACTION)
    noise, member = torch.randn(2, 3, HORIZON, NOISE), torch.zeros(2, 3, dtype=torch.int64)
    forecasts = network.sample(*given, noise, member)

    def changed(step: int, component: int) -> list[bool]:
        """Which steps of the forecasts change with one number of the noise."""
        other = noise.clone()
        other[:, :, step, component] += 1.0
        differs = network.sample(*given, other, member) != forecasts
        return [bool(differs[:, :, t].any()) for t in range(HORIZON)]

    for component in range(NOISE):
        lasts = component < LASTING
        assert changed(0, component) == [True] * HORIZON
        later = [False] * 3 + [True] * (HORIZON - 3)
        assert changed(3, component) == ([False] * HORIZON if lasts else later)


@pytest.mark.parametrize("single", [0.0, 1.0])
@pytest.mark.parametrize("name", NAMES)
def test_training_lowers_the_loss_and_leaves_the_ensemble_alone(name: str, single: float) -> None:
    network = generator(name, single=single)
    before = {k: v.clone() for k, v in network.state_dict().items() if k.startswith("ensemble")}
    torch.manual_seed(0)
    batch = {"states": torch.randn(8, HORIZON + 1, STATE), "actions": torch.randn(8, HORIZON, 2)}
    optimizer = torch.optim.Adam([p for p in network.parameters() if p.requires_grad], 1e-2)
    losses = []
    for _ in range(40):
        loss = network.training_step(batch)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(float(loss.detach()))
    assert np.mean(losses[-5:]) < np.mean(losses[:5])
    for key, value in before.items():
        assert torch.equal(network.state_dict()[key], value)


@pytest.mark.parametrize("name", NAMES)
def test_single_transitions_teach_nothing_of_the_lasting_noise(name: str) -> None:
    """Nor of where a trajectory began, but linearly; whole trajectories do."""
    network = generator(name)
    decode = network.decode
    batch = {"states": torch.randn(8, HORIZON + 1, STATE), "actions": torch.randn(8, HORIZON, 2)}
    lasts_and_stays = slice(-LASTING - STATE, None)
    for step, learns in ((0, False), (network.first_free(), True)):
        network.zero_grad()
        network.losses(batch, step)["loss"].backward()
        assert decode.first.weight.grad is not None
        assert decode.linear.weight.grad is not None
        assert bool(decode.first.weight.grad[:, lasts_and_stays].any()) is learns
        assert bool(decode.first.weight.grad[:, : -LASTING - STATE].any())
        assert bool(decode.linear.weight.grad[:, -STATE:].any())


@pytest.mark.parametrize("name", NAMES)
def test_a_transition_is_scored_as_it_is_forecast(name: str) -> None:
    """Of trajectories that the network itself forecasts without noise, the mean has no error."""
    network = generator(name)
    torch.nn.init.normal_(network.decode.linear.weight, std=0.1)
    network.decode.out.weight.data.mul_(0.1)  # so that forecasts stay small
    s0, actions = torch.randn(8, STATE), torch.randn(8, HORIZON, ACTION)
    members = torch.randn(8, 1, HORIZON, STATE).expand(-1, network.members_count(), -1, -1)
    none = torch.zeros(8, 1, HORIZON, NOISE), torch.zeros(8, 1, dtype=torch.int64)
    with torch.no_grad():
        baselines = network.baselines(s0, actions, members)
        forecasts = network._generate(s0, actions, *none, baselines)[:, 0]
    states = torch.cat([s0[:, None], forecasts], 1)
    batch = {"states": states, "actions": actions, "members": members}
    told = {key: float(value.detach()) for key, value in network.losses(batch, 0).items()}
    assert told["loss/mean"] < np.log(1e-8)
    assert told["loss"] == pytest.approx(told["loss/transitions"] + told["loss/mean"])


@pytest.mark.parametrize("single", [0.0, 1.0])
def test_every_member_serves(single: float, monkeypatch: pytest.MonkeyPatch) -> None:
    network = generator("residual_crps", single=single)
    members = torch.arange(1.0, 1 + network.members_count())[None, :, None, None]
    members = members.expand(8, -1, HORIZON, STATE)
    beside, seen = network.beside, set()

    def watched(baseline: torch.Tensor, actions: torch.Tensor) -> torch.Tensor:
        seen.update(baseline[:, 1:].flatten().tolist())
        return beside(baseline, actions)

    monkeypatch.setattr(network, "beside", watched)
    states, actions = torch.randn(8, HORIZON + 1, STATE), torch.randn(8, HORIZON, ACTION)
    network.losses({"states": states, "actions": actions, "members": members}, 0)
    assert seen == {1.0, 2.0, 3.0}


def test_so_many_whole_trajectories_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    network = generator("full_crps", single=0.0)
    generate, rows = network._generate, []

    def watched(s0: torch.Tensor, *rest: torch.Tensor) -> torch.Tensor:
        rows.append(len(s0))
        return generate(s0, *rest)

    monkeypatch.setattr(network, "_generate", watched)
    for count in (TRAJECTORIES + 3, TRAJECTORIES - 3):
        states, actions = (
            torch.randn(count, HORIZON + 1, STATE),
            torch.randn(count, HORIZON, ACTION),
        )
        network.losses({"states": states, "actions": actions}, 0)
    assert rows == [TRAJECTORIES, TRAJECTORIES - 3]


def test_energy_and_increments_count_by_their_weights(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("study.models.crps.LAG", 2)
    states, actions = torch.randn(8, HORIZON + 1, STATE), torch.randn(8, HORIZON, ACTION)
    forecasts = torch.randn(8, 2, HORIZON, STATE)

    def loss(**weights: float) -> float:
        network = generator("full_crps", single=0.0, **weights)
        monkeypatch.setattr(network, "_generate", lambda *_: forecasts)
        return float(network.losses({"states": states, "actions": actions}, 0)["loss"])

    x, y = forecasts.movedim(1, 2), states[:, 1:]
    each = fair_score(x.movedim(-1, -2)[..., None], y[..., None]).mean((0, 1))
    x, y = x / each, y / each
    plain, joint = each.log().mean(), fair_score(x, y).mean().log()
    moved = fair_score(x[:, 2:] - x[:, :-2], y[:, 2:] - y[:, :-2]).mean().log()
    assert loss(energy=0.0) == pytest.approx(float(plain), abs=1e-5)
    assert loss(energy=0.7) == pytest.approx(float(plain + 0.7 * joint), abs=1e-5)
    both = float(plain + 0.2 * moved)
    assert loss(energy=0.0, increments=0.2) == pytest.approx(both, abs=1e-5)


def test_wide_transitions_count_more_in_the_logarithmic_score() -> None:
    """By their standard deviation to the power 3/4."""
    error, deviation = torch.tensor([[1.0], [3.0]]), torch.tensor([[0.5], [8.0]])
    weight = (deviation / deviation.mean()) ** 0.75
    each = 0.5 * (error / deviation) ** 2 + deviation.log()
    expected = float((weight * each).sum() / weight.sum())
    assert float(logarithmic_score(error, deviation.square())) == pytest.approx(expected)


def test_the_logarithmic_score_of_equal_widths_is_that_of_scipy() -> None:
    draws = np.random.default_rng(0)
    error = draws.normal(size=(50, 3))
    deviation = np.array([0.5, 2.0, 1.0])
    found = logarithmic_score(torch.from_numpy(error), torch.from_numpy(deviation**2).expand(50, 3))
    expected = -norm.logpdf(error, scale=deviation).mean() - 0.5 * np.log(2 * np.pi)
    assert float(found) == pytest.approx(expected)


def test_the_logarithmic_score_is_least_at_the_true_width() -> None:
    """Also where transitions of two widths are weighed against each other."""
    true = torch.tensor([0.2, 3.0]).double().repeat(200_000)[:, None]
    draws = torch.randn(true.shape, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    error = true * draws
    factors = torch.tensor([1.0, 1.0], dtype=torch.float64, requires_grad=True)
    deviation = true * factors.repeat(200_000)[:, None]
    logarithmic_score(error, deviation.square()).backward()
    assert factors.grad is not None
    assert factors.grad.abs().max() < 0.005
    with torch.no_grad():
        wrong = logarithmic_score(error, (2 * true).square())
        right = logarithmic_score(error, true.square())
    assert float(wrong - right) > 0.1


def test_lively_steps_are_drawn_more_often(monkeypatch: pytest.MonkeyPatch) -> None:
    network = generator("full_crps")
    states = torch.zeros(500, HORIZON + 1, STATE)
    # At one step of the horizon everything changes by three usual deviations, else nothing does.
    states[:, 3:] = 3.0 * network.delta_std
    transition, drawn = network.decode.transition, []

    def watched(*given: torch.Tensor) -> Any:
        drawn.append(given[2][:, 0])
        return transition(*given)

    monkeypatch.setattr(network.decode, "transition", watched)
    marked = torch.zeros(500, HORIZON, ACTION)
    marked[:, 2] = 1.0
    torch.manual_seed(0)
    for _ in range(20):
        network.losses({"states": states, "actions": marked}, 0)
    # A weight of 1 + 9 against 1 for each of the others.
    assert float(torch.cat(drawn).mean()) == pytest.approx(10 / (10 + HORIZON - 1), abs=0.06)


def test_the_rate_falls_before_free_forecasts_and_at_the_end() -> None:
    rates = np.array([two_cycles(step, 1000, 800) for step in range(1000)])
    assert (rates > 0).all()
    assert rates.max() == pytest.approx(1.0, abs=0.02)
    assert rates[798] < 0.01
    assert rates[800:].max() == pytest.approx(0.1, abs=0.005)
    assert rates[-1] < 0.01
    for single in (0, 1000):
        assert all(0 < two_cycles(step, 1000, single) <= 1 for step in range(1000))


def test_the_optimiser_forgets_when_its_task_changes() -> None:
    network = generator("full_crps")
    network.settings["train"]["steps"] = 10
    assert [step for step in range(10) if network.forgets(step)] == [8]
    optimizer = torch.optim.AdamW(network.parameters())
    batch = {"states": torch.randn(8, HORIZON + 1, STATE), "actions": torch.randn(8, HORIZON, 2)}
    network.losses(batch, 0)["loss"].backward()
    optimizer.step()
    for step, remembers in ((7, True), (8, False)):
        network._trainer = SimpleNamespace(global_step=step, optimizers=[optimizer])  # type: ignore[assignment]
        network.on_train_batch_start()
        assert bool(optimizer.state) is remembers


def test_the_budget_is_that_of_the_section_crps() -> None:
    config = Config(crps=Crps(steps=2505, batch_size=7, learning_rate=0.02))
    found = Pipeline(config).train(Cell("pusher", "low", "full_crps", 0)).settings["sections"]
    expected = asdict(config.train) | {
        "steps": 2505,
        "batch_size": 7,
        "learning_rate": 0.02,
        "validate_every": 250,
        "patience": 2505,
    }
    assert found["train"] == expected
    rival = Pipeline(config).train(Cell("pusher", "low", "full_vae", 0)).settings["sections"]
    assert rival["train"] == asdict(config.train)


@pytest.mark.parametrize("increments", [0.0, 0.5])
def test_the_loss_is_relative(increments: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every number counts by its own uncertainty: units change the loss by a constant."""
    network = generator("full_crps")
    network.settings["crps"]["increments"] = increments
    monkeypatch.setattr("study.models.crps.LAG", 2)
    torch.manual_seed(0)
    states, actions = torch.randn(8, HORIZON + 1, STATE), torch.randn(8, HORIZON, ACTION)
    forecasts = torch.randn(8, 2, HORIZON, STATE)
    units = torch.tensor([1.0, 10.0, 0.1])

    def loss(by: torch.Tensor) -> float:
        monkeypatch.setattr(network, "_generate", lambda *_: forecasts * by)
        batch = {"states": states * by, "actions": actions}
        return float(network.losses(batch, network.settings["train"]["steps"])["loss"])

    constant = float(units.log().mean())
    assert loss(units) == pytest.approx(loss(torch.ones(STATE)) + constant, abs=1e-4)
