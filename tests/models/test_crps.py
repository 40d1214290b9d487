"""The generators beyond the paper: a score without bias, and noise that lasts."""

from dataclasses import asdict
from typing import Any

import numpy as np
import pytest
import scoringrules
import torch
from scipy.stats import norm

from study.config import Config, Crps
from study.grid import Cell
from study.models.crps import CrpsGenerator, cut, fair_score, mean_error, two_cycles
from study.models.decoder import RecurrentDecoder
from study.models.transition import TransitionDecoder
from study.pipeline import Pipeline
from tests.models.common import ACTION, HORIZON, STATE, model

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
    assert isinstance(network.decode, TransitionDecoder)
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


@pytest.mark.parametrize("name", NAMES)
def test_training_lowers_the_loss_and_leaves_the_ensemble_alone(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    network = generator(name)
    monkeypatch.setattr(network, "tell", lambda *_: None)
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
def test_single_transitions_teach_nothing_of_the_lasting_noise(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In the first part of training; in the last, which forecasts freely, it counts."""
    network = generator(name)
    monkeypatch.setattr(network, "tell", lambda *_: None)
    decode = network.decode
    assert isinstance(decode, TransitionDecoder)
    batch = {"states": torch.randn(8, HORIZON + 1, STATE), "actions": torch.randn(8, HORIZON, 2)}
    steps = network.settings["train"]["steps"]
    drivers = slice(-NOISE, -NOISE + LASTING)
    for step, learns in ((0, False), (steps - 1, True)):
        network.zero_grad()
        network.losses(batch, step)["loss"].backward()
        assert decode.first.weight.grad is not None
        assert bool(decode.first.weight.grad[:, drivers].any()) is learns
        assert bool(decode.first.weight.grad[:, -NOISE + LASTING :].any())


def test_pieces_are_of_one_trajectory_each_in_order() -> None:
    """Numbers that name trajectory and step stay together, whatever step the first piece has."""
    count, horizon, members, length = 3, 11, 2, 4
    named = 100.0 * torch.arange(count)[:, None] + torch.arange(horizon + 1)
    states, baselines = named[..., None], named[:, None, :, None].expand(-1, members, -1, -1)
    seen = set()
    for seed in range(20):
        torch.manual_seed(seed)
        pieces, actions, under = cut(states, named[:, :-1, None], baselines, length)
        assert pieces.shape == (count * 2, length + 1, 1)
        assert torch.equal(pieces[:, :-1], actions)
        assert torch.equal(pieces[:, None].expand(-1, members, -1, -1), under)
        steps = pieces[..., 0] - pieces[:, :1, 0]
        assert torch.equal(steps, torch.arange(length + 1.0).expand_as(steps))
        starts = pieces[:, 0, 0].reshape(count, 2)
        assert torch.equal(starts[:, 1], starts[:, 0] + length)
        seen |= set((starts[0] % 100).tolist())
    assert seen == {float(first) for first in range(8)}


def test_pieces_grow_to_the_whole_horizon() -> None:
    network = generator("full_crps")
    network.settings["train"]["steps"] = 100
    lengths = [network.piece(step, 120) for step in range(100)]
    assert lengths[0] == 1
    assert lengths[-1] == 120
    assert lengths == sorted(lengths)
    assert max(network.piece(step, 20) for step in range(100)) == 20


def test_the_rate_falls_before_free_forecasts_and_at_the_end() -> None:
    network = generator("full_crps")
    steps = network.settings["train"]["steps"] = 1000
    rates = np.array([two_cycles(step, steps) for step in range(steps)])
    single = sum(network.piece(step, HORIZON) == 1 for step in range(steps))
    assert (rates > 0).all()
    assert rates.max() == pytest.approx(1.0, abs=0.02)
    assert rates[single - 2] < 0.01
    assert rates[single:].max() == pytest.approx(0.2, abs=0.005)
    assert rates[-1] < 0.01


@pytest.mark.parametrize("output", ["direct", "increment"])
@pytest.mark.parametrize("name", NAMES)
def test_a_recurrent_decoder_is_trained_on_whole_trajectories(
    name: str, output: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    network = generator(name, decoder="recurrent", residual_output=output, full_output=output)
    monkeypatch.setattr(network, "tell", lambda *_: None)
    assert network.piece(0, HORIZON) == HORIZON
    optimizer = torch.optim.SGD(network.parameters(), 1.0)
    assert isinstance(network.schedule(optimizer, 1.0, 10), torch.optim.lr_scheduler.OneCycleLR)
    batch = {"states": torch.randn(8, HORIZON + 1, STATE), "actions": torch.randn(8, HORIZON, 2)}
    network.losses(batch, 0)["loss"].backward()
    assert isinstance(network.decode, RecurrentDecoder)
    gradient = network.decode.driven.weight.grad
    assert gradient is not None
    assert bool(gradient[:, -NOISE:].any(0).all())  # lasting noise and all


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


def test_the_error_of_the_mean_has_no_bias() -> None:
    """Against the closed form for normal forecasts and observations."""
    generator = torch.Generator().manual_seed(0)
    observed = 1.0 + 0.5 * torch.randn(400_000, 1, 1, generator=generator).double()
    forecasts = 1.6 + 0.8 * torch.randn(400_000, 1, 2, 1, generator=generator).double()
    of_mean = 0.6**2 + 0.5**2
    expected = of_mean / (of_mean + 0.8**2)
    assert float(mean_error(forecasts, observed)) == pytest.approx(expected, abs=0.005)


@pytest.mark.parametrize("increments", [0.0, 0.5])
def test_the_loss_is_relative(increments: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every number counts by its own uncertainty: units change the loss by a constant."""
    network = generator("full_crps")
    network.settings["crps"]["increments"] = increments
    monkeypatch.setattr(network, "tell", lambda *_: None)
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
