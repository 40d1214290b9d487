"""The generator: a forecast step has the distribution of `transition`."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from study.data.normalization import Normalization
from study.models.networks.architecture import Architecture
from study.models.networks.generator import GRADIENT_DECAY, GeneratorDynamics
from study.models.unroll.frame import turn
from tests.helpers.models import ACTION, HORIZON, STATE
from tests.helpers.networks import ROWS, architecture, randomize, units

NOISE, UNUSED = 3, 2


def shape_of(product: bool = True) -> Architecture:
    """As in the CRPS models: s_0 is one of the inputs, and has no linear term."""
    shape = architecture(memory=False, product=product)
    return replace(shape, inputs=ACTION + UNUSED, linear_start=False)


def untrained(rotating: bool = False, product: bool = True) -> GeneratorDynamics:
    torch.manual_seed(0)
    return GeneratorDynamics(units(rotating), shape_of(product), NOISE, UNUSED)


def trained(rotating: bool = False, product: bool = True) -> GeneratorDynamics:
    """A generator whose output depends on all inputs."""
    built = untrained(rotating, product)
    randomize(built)
    nn.init.normal_(built.stem.weight, std=0.3)
    return built


def arguments() -> dict[str, Tensor]:
    """Of `generate`."""
    return {
        "s0": torch.randn(1, ROWS, STATE),
        "inputs": torch.randn(1, ROWS, HORIZON, ACTION + UNUSED),
        "offset": 0.1 * torch.randn(1, ROWS, HORIZON, STATE),
        "noise": torch.randn(1, ROWS, HORIZON, NOISE),
    }


PAIRS = np.array([[0, 1], [3, 4], [5, 2]])
"""Turned pairs of a state of seven components. The axis points from the first to the second."""


def canonical() -> GeneratorDynamics:
    """A generator in a canonical frame."""
    scale, delta_std = np.full(7, 0.5, np.float32), np.full(7, 0.3, np.float32)
    zero, one = np.zeros(7, np.float32), np.ones(ACTION, np.float32)
    none = np.zeros((0, 3), np.int64)
    units = Normalization(zero, scale, one, one, delta_std, none, PAIRS, PAIRS[:2])
    torch.manual_seed(0)
    generator = GeneratorDynamics(units, replace(shape_of(), canonical=True), NOISE, UNUSED)
    randomize(generator)
    return generator


def turned(values: Tensor) -> Tensor:
    """Vectors [..., 7] turned by 2 rad."""
    angle = torch.tensor(2.0)
    return turn(values, torch.from_numpy(PAIRS), angle.cos(), angle.sin())


def set_output_to_zero(generator: GeneratorDynamics) -> None:
    for layer in (generator.skip, generator.output, generator.noise_shift, generator.noise_output):
        nn.init.zeros_(layer.weight)
    nn.init.zeros_(generator.output.bias)


@pytest.mark.parametrize("product", [True, False])
@pytest.mark.parametrize("rotating", [False, True])
def test_a_forecast_step_has_the_distribution_of_transition(rotating: bool, product: bool) -> None:
    generator, values = trained(rotating, product), arguments()
    first = {name: value if name == "s0" else value[:, :, :1] for name, value in values.items()}
    forecast = generator.generate(**first)[:, :, 0]
    change = torch.randn(1, ROWS, STATE)
    error, factor = generator.transition(values["s0"], values["inputs"][:, :, 0], change)
    assert factor.shape == (1, ROWS, NOISE, STATE)
    output = change - error + torch.einsum("mbz,mbzd->mbd", values["noise"][:, :, 0], factor)
    unit = torch.from_numpy(units().delta_std)
    torch.testing.assert_close(forecast, values["s0"] + unit * output + values["offset"][:, :, 0])


def test_the_covariance_depends_on_the_state() -> None:
    generator, values = trained(), arguments()
    _, factor = generator.transition(
        5 * values["s0"], values["inputs"][:, :, 0], torch.zeros(1, ROWS, STATE)
    )
    assert (factor[0, 0] - factor[0, 1]).abs().max() > 0.01


def test_the_offset_moves_the_state() -> None:
    generator, values = trained(), arguments()
    set_output_to_zero(generator)
    expected = values["s0"][:, :, None] + values["offset"].cumsum(2)
    torch.testing.assert_close(generator.generate(**values), expected)


def test_the_gradient_decays_by_a_factor_at_every_step() -> None:
    generator, values = trained(), arguments()
    set_output_to_zero(generator)
    s0 = values["s0"].requires_grad_()
    last = generator.generate(**values)[:, :, -1]
    (gradient,) = torch.autograd.grad(last.sum(), s0)
    torch.testing.assert_close(gradient, torch.full_like(s0, GRADIENT_DECAY**HORIZON))


def test_forecasts_in_blocks_without_gradient_are_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("study.models.networks.dynamics.MAX_ROWS", ROWS - 1)
    generator, values = trained(), arguments()
    expected = generator.generate(**values)
    with torch.no_grad():
        torch.testing.assert_close(generator.generate(**values), expected)


@pytest.mark.parametrize("product", [True, False])
def test_the_last_inputs_have_no_effect_before_training(product: bool) -> None:
    generator, values = untrained(product=product), arguments()
    expected = generator.generate(**values)
    changed = values | {"inputs": values["inputs"].clone()}
    changed["inputs"][..., ACTION:] += 1.0
    assert torch.equal(generator.generate(**changed), expected)
    changed["inputs"][..., :ACTION] += 1.0
    assert not torch.equal(generator.generate(**changed), expected)
    changed = values | {"noise": values["noise"] + 1.0}
    assert not torch.equal(generator.generate(**changed), expected)


def test_all_inputs_may_have_an_effect_before_training() -> None:
    generator = GeneratorDynamics(units(), shape_of(), NOISE)
    assert generator.stem.weight.all()


@pytest.mark.parametrize("product", [True, False])
def test_all_weights_are_trained(product: bool) -> None:
    """The gradients of rollouts reach every weight, those of the last inputs as well."""
    generator, values = untrained(product=product), arguments()
    generator.generate(**values).square().sum().backward()
    for name, parameter in generator.named_parameters():
        if parameter.requires_grad:
            assert parameter.grad is not None, name
            assert parameter.grad.any(), name
    assert generator.stem.weight.grad is not None
    assert generator.stem.weight.grad[:, -UNUSED:].any(-1).all()


def test_in_the_canonical_frame_forecasts_turn_with_the_state() -> None:
    generator, values = canonical(), arguments() | {"s0": torch.randn(1, ROWS, 7)}
    values["offset"] = torch.zeros(1, ROWS, HORIZON, 7)
    forecast = generator.generate(**values)
    of_turned = generator.generate(**values | {"s0": turned(values["s0"])})
    torch.testing.assert_close(of_turned, turned(forecast), rtol=1e-4, atol=1e-4)
    assert (of_turned - forecast).abs().max() > 0.1


def test_in_the_canonical_frame_a_step_has_the_distribution_of_transition() -> None:
    generator, values = canonical(), arguments() | {"s0": torch.randn(1, ROWS, 7)}
    first = {name: value if name == "s0" else value[:, :, :1] for name, value in values.items()}
    first["offset"] = torch.zeros(1, ROWS, 1, 7)
    change = (generator.generate(**first)[:, :, 0] - values["s0"]) / 0.3
    error, factor = generator.transition(values["s0"], values["inputs"][:, :, 0], change)
    expected = torch.einsum("mbz,mbzd->mbd", values["noise"][:, :, 0], factor)
    torch.testing.assert_close(error, expected, rtol=1e-4, atol=1e-4)


def test_in_the_canonical_frame_a_transition_does_not_depend_on_direction() -> None:
    generator, state, change = canonical(), torch.randn(1, ROWS, 7), torch.randn(1, ROWS, 7)
    inputs = torch.randn(1, ROWS, ACTION + UNUSED)
    expected = generator.transition(state, inputs, change)
    found = generator.transition(turned(state), inputs, turned(change))
    torch.testing.assert_close(found, expected, rtol=1e-4, atol=1e-4)
