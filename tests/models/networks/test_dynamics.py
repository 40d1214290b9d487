"""The dynamics network: causal, consistent, and within the range of its training states."""

from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import Tensor, nn
from torch.nn.functional import silu

from study.models.networks.architecture import Architecture
from study.models.networks.dynamics import DynamicsNetwork
from tests.helpers.models import ACTION, HORIZON, STATE
from tests.helpers.networks import ROWS, WIDTH, architecture, history_of, inputs, randomize, units

ARCHITECTURES = [
    architecture(memory=True),
    architecture(memory=False),
    architecture(memory=True, product=False),
    architecture(memory=False, product=False),
    replace(architecture(networks=3), delta=False),
    replace(architecture(memory=False), layers=0),
    replace(architecture(), linear_start=False),
]


def network(shape: Architecture, rotating: bool = True) -> DynamicsNetwork:
    torch.manual_seed(0)
    built = DynamicsNetwork(units(rotating), shape)
    randomize(built)
    return built


def set_output_to_zero(dynamics: DynamicsNetwork) -> None:
    for name, parameter in dynamics.named_parameters():
        if name.startswith(("output", "skip", "start_skip")):
            nn.init.zeros_(parameter)


@pytest.mark.parametrize("shape", ARCHITECTURES)
def test_teacher_forcing_with_its_own_predictions_changes_nothing(shape: Architecture) -> None:
    dynamics = network(shape)
    values = inputs(dynamics)
    states, tops = dynamics.rollout(**values, return_tops=True)
    history = history_of(values.pop("s0"), states)
    mean, top = dynamics.mean(history, **values)
    assert states.std() > 0.1
    torch.testing.assert_close(mean, states, rtol=1e-4, atol=1e-5)
    torch.testing.assert_close(top, tops, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("shape", ARCHITECTURES)
@pytest.mark.parametrize("teacher_forced", [True, False])
def test_it_is_causal(teacher_forced: bool, shape: Architecture) -> None:
    """s_1 … s_t do not depend on i_t, the offset and s_t; s_{t+1} does."""
    dynamics = network(shape)
    values = inputs(dynamics)
    if teacher_forced:
        values["state"] = history_of(values.pop("s0"), values["offset"])
    predict: Any = dynamics.mean if teacher_forced else dynamics.rollout
    expected, _ = predict(**values)
    for name in set(values) - {"s0", "hidden"}:
        for step in range(HORIZON):
            changed = values | {name: values[name].clone()}
            changed[name][:, :, step] += 1.0
            found, _ = predict(**changed)
            torch.testing.assert_close(found[:, :, :step], expected[:, :, :step])
            assert not torch.allclose(found[:, :, step], expected[:, :, step])


@pytest.mark.parametrize("shape", [shape for shape in ARCHITECTURES if shape.memory])
def test_the_memory_starts_from_s0_and_what_else_it_depends_on(shape: Architecture) -> None:
    dynamics = network(shape)
    s0, start = torch.randn(shape.networks, 4, STATE), torch.randn(shape.networks, 4, shape.start)
    hidden = dynamics.start(s0, start)
    assert hidden.shape == (shape.networks, 4, WIDTH)
    assert hidden.abs().max() <= 1
    for changed in (dynamics.start(s0 + 1, start), dynamics.start(s0, start + 1)):
        assert not torch.isclose(changed, hidden).all(-1).any()


@pytest.mark.parametrize("delta", [True, False])
def test_the_offset_is_added(delta: bool) -> None:
    """With an output of zero, the offset is the state, or its change."""
    dynamics = network(replace(architecture(), delta=delta))
    set_output_to_zero(dynamics)
    values = inputs(dynamics)
    states, _ = dynamics.rollout(**values)
    offset = values["offset"]
    expected = values["s0"][:, :, None] + offset.cumsum(2) if delta else offset
    torch.testing.assert_close(states, expected)


@pytest.mark.parametrize("delta", [True, False])
def test_the_output_has_the_unit_of_a_change(delta: bool) -> None:
    dynamics = network(replace(architecture(memory=False), delta=delta))
    set_output_to_zero(dynamics)
    nn.init.ones_(dynamics.output.bias)
    values = inputs(dynamics) | {"offset": torch.zeros(1, ROWS, HORIZON, STATE)}
    first = dynamics.rollout(**values)[0][:, :, 0]
    unit = torch.from_numpy(units().delta_std)
    expected = values["s0"] + unit if delta else torch.ones(1, ROWS, STATE)
    torch.testing.assert_close(first, expected)


@pytest.mark.parametrize("delta", [True, False])
def test_a_linear_term_of_s0_is_added_at_every_step(delta: bool) -> None:
    """With an output of zero, the term is added to the offset, and `step` does not contain it."""
    dynamics = network(replace(architecture(networks=2), delta=delta))
    set_output_to_zero(dynamics)
    weight = torch.randn(2, STATE, STATE)
    dynamics.load_state_dict(dynamics.state_dict() | {"start_skip.weight": weight})
    values = inputs(dynamics)
    s0 = values["s0"]
    unit = torch.from_numpy(units().delta_std) if delta else 1.0
    term = values["offset"] + (unit * torch.einsum("mbi,mid->mbd", s0, weight))[:, :, None]
    states, _ = dynamics.rollout(**values)
    torch.testing.assert_close(states, s0[:, :, None] + term.cumsum(2) if delta else term)
    history = torch.cat([s0[:, :, None], torch.randn_like(states[:, :, 1:])], 2)
    others = {name: value for name, value in values.items() if name != "s0"}
    mean, _ = dynamics.mean(history, **others)
    torch.testing.assert_close(mean, history + term if delta else term)
    assert not dynamics.step(history, values["inputs"], values["hidden"])[0].any()


def test_the_linear_term_of_s0_has_no_effect_before_training() -> None:
    """Training changes it. It does not exist without `linear_start` or without `product`."""
    dynamics = DynamicsNetwork(units(), architecture())
    states, _ = dynamics.rollout(**inputs(dynamics))
    states.square().sum().backward()
    assert dynamics.start_skip is not None
    assert not dynamics.start_skip.weight.any()
    assert dynamics.start_skip.weight.grad is not None
    assert dynamics.start_skip.weight.grad.all()
    for changes in ({"linear_start": False}, {"product": False}):
        assert network(replace(architecture(), **changes)).start_skip is None


@pytest.mark.parametrize("shape", [shape for shape in ARCHITECTURES if not shape.memory])
def test_a_rollout_from_a_later_state(shape: Architecture) -> None:
    """With the trajectory's s_0, the states are those of the whole rollout."""
    dynamics = network(shape)
    values = inputs(dynamics)
    states, _ = dynamics.rollout(**values)
    later = {name: values[name][:, :, 2:] for name in ("inputs", "offset")}
    found, _ = dynamics.rollout(states[:, :, 1], **later, start=values["s0"])
    torch.testing.assert_close(found, states[:, :, 2:])
    without, _ = dynamics.rollout(states[:, :, 1], **later)
    assert torch.allclose(without, found) != shape.product


@pytest.mark.parametrize("memory", [True, False])
def test_headings_are_periodic(memory: bool) -> None:
    """A full rotation changes the angle itself, and no other feature."""
    dynamics = network(architecture(memory))
    values = inputs(dynamics)
    state = torch.randn(1, ROWS, HORIZON, STATE)
    angle = int(dynamics.angles)
    assert angle == 2
    rotated = state.clone()
    rotated[..., angle] += 2 * torch.pi / dynamics.angle_scale

    def change() -> float:
        others = (values["inputs"], values["hidden"])
        difference = dynamics.step(state, *others)[0] - dynamics.step(rotated, *others)[0]
        return float(difference.detach().abs().max())

    assert change() > 0.1
    with torch.no_grad():
        for layer in [dynamics.skip, dynamics.stem, *([dynamics.gates] if memory else [])]:
            layer.weight[:, angle] = 0
    assert change() < 1e-3
    # Half a rotation changes the features of ψ, but not those of 2ψ.
    rotated[..., angle] -= torch.pi / dynamics.angle_scale
    assert change() > 0.1
    with torch.no_grad():
        for layer in [dynamics.skip, dynamics.stem, *([dynamics.gates] if memory else [])]:
            layer.weight[:, STATE : STATE + 2] = 0
    assert change() < 1e-3


@pytest.mark.parametrize("shape", ARCHITECTURES)
def test_rollouts_keep_to_the_range_of_the_training_states(shape: Architecture) -> None:
    dynamics = network(shape)
    values = inputs(dynamics)
    values["offset"] *= 20
    unlimited, _ = dynamics.rollout(**values)
    states = torch.rand(20, HORIZON, STATE) - 0.5
    lowest, highest = states.amin((0, 1)), states.amax((0, 1))
    assert bool((unlimited > highest).any())
    assert bool((unlimited < lowest).any())
    dynamics.set_range(states)
    limited, _ = dynamics.rollout(**values)
    torch.testing.assert_close(limited.amax((0, 1, 2)), highest)
    torch.testing.assert_close(limited.amin((0, 1, 2)), lowest)
    # The range is saved with the weights.
    loaded = DynamicsNetwork(units(True), shape)
    loaded.load_state_dict(dynamics.state_dict())
    assert torch.equal(loaded.rollout(**values)[0], limited)


@pytest.mark.parametrize("shape", ARCHITECTURES)
def test_rollouts_in_blocks_without_gradient_are_the_same(
    shape: Architecture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("study.models.networks.dynamics.MAX_ROWS", ROWS - 1)
    dynamics = network(shape)
    values = inputs(dynamics)
    expected = dynamics.rollout(**values, return_tops=True)
    with torch.no_grad():
        found = dynamics.rollout(**values, return_tops=True)
        for ours, theirs in zip(found, expected, strict=True):
            torch.testing.assert_close(ours, theirs)
        nothing = {name: value[:, :0] for name, value in values.items()}
        assert dynamics.rollout(**nothing)[0].shape == (shape.networks, 0, HORIZON, STATE)


def test_the_gradient_decays_at_every_step() -> None:
    dynamics = network(architecture())
    set_output_to_zero(dynamics)
    values = inputs(dynamics)
    s0 = values["s0"].requires_grad_()
    for decay in (1.0, 0.7):
        dynamics.gradient_decay = decay
        states, _ = dynamics.rollout(**values)
        (gradient,) = torch.autograd.grad(states[:, :, -1].sum(), s0)
        torch.testing.assert_close(gradient, torch.full_like(s0, decay**HORIZON))


@pytest.mark.parametrize("shape", ARCHITECTURES)
def test_networks_side_by_side_are_independent(shape: Architecture) -> None:
    """Values and gradients are those of each network alone."""
    count = 3
    together = network(replace(shape, networks=count))
    values = inputs(together)
    rollout, _ = together.rollout(**values)
    history = history_of(values["s0"], rollout.detach())
    others = {name: value for name, value in values.items() if name != "s0"}
    mean, _ = together.mean(history, **others)
    (rollout.square().sum() + mean.square().sum()).backward()
    parameters = dict(together.named_parameters())
    for m in range(count):
        part = slice(m, m + 1)
        alone = DynamicsNetwork(units(True), replace(shape, networks=1))
        tensors = {
            name: value[part] if name in parameters else value
            for name, value in together.state_dict().items()
        }
        alone.load_state_dict(tensors)
        of_alone = {name: value[part] for name, value in values.items()}
        found, _ = alone.rollout(**of_alone)
        del of_alone["s0"]
        found_mean, _ = alone.mean(history[part], **of_alone)
        torch.testing.assert_close(found, rollout[part])
        torch.testing.assert_close(found_mean, mean[part])
        (found.square().sum() + found_mean.square().sum()).backward()
        for name, parameter in alone.named_parameters():
            if parameter.requires_grad and not name.startswith("initial_hidden"):
                gradient = parameters[name].grad
                assert gradient is not None
                torch.testing.assert_close(parameter.grad, gradient[part], rtol=1e-3, atol=1e-4)


def linear(weight: Tensor, bias: Tensor) -> nn.Linear:
    layer = nn.Linear(*weight.shape)
    layer.load_state_dict({"weight": weight.T, "bias": bias})
    return layer


def test_without_product_a_network_with_memory_is_a_gru() -> None:
    """Its inputs are the state and the inputs; its output is linear."""
    dynamics = network(architecture(memory=True, product=False))
    values = inputs(dynamics)
    x = STATE + ACTION
    cell = nn.GRUCell(x, WIDTH)
    n, r, u = dynamics.gates.weight[0].detach().T.chunk(3)
    b_n, b_r, b_u = dynamics.gates.bias[0, 0].detach().chunk(3)
    zero = torch.zeros(2 * WIDTH)
    cell.load_state_dict(
        {
            "weight_ih": torch.cat([r, u, n]),
            "weight_hh": dynamics.gates_of_hidden.weight[0].detach().T,
            "bias_ih": torch.cat([b_r, b_u, b_n]),
            "bias_hh": torch.cat([zero, dynamics.hidden_bias[0, 0].detach()]),
        }
    )
    output = linear(dynamics.output.weight[0].detach(), dynamics.output.bias[0, 0].detach())
    state, hidden, states = values["s0"][0], values["hidden"][0], []
    for t in range(HORIZON):
        hidden = cell(torch.cat([state, values["inputs"][0, :, t]], -1), hidden)
        change = output(hidden) * torch.from_numpy(units().delta_std)
        state = state + values["offset"][0, :, t] + change
        states.append(state)
    torch.testing.assert_close(dynamics.rollout(**values)[0][0], torch.stack(states, 1))
    # It has no other weights than these and those of h_0.
    parts = {name.split(".")[0] for name, _ in dynamics.named_parameters()}
    assert parts == {"output", "initial_hidden", "gates", "gates_of_hidden", "hidden_bias"}


def test_without_product_a_network_without_memory_is_an_mlp() -> None:
    """Of SiLU units, whose layers after the first are residual."""
    dynamics = network(architecture(memory=False, product=False))
    values = inputs(dynamics)
    layers: list[Any] = [dynamics.stem, *dynamics.layers, dynamics.output]
    first, *residual, output = (
        linear(layer.weight[0].detach(), layer.bias[0, 0].detach()) for layer in layers
    )
    assert len(residual) == 2
    state, states = values["s0"][0], []
    for t in range(HORIZON):
        y = silu(first(torch.cat([state, values["inputs"][0, :, t]], -1)))
        for layer in residual:
            y = y + silu(layer(y))
        change = output(y) * torch.from_numpy(units().delta_std)
        state = state + values["offset"][0, :, t] + change
        states.append(state)
    torch.testing.assert_close(dynamics.rollout(**values)[0][0], torch.stack(states, 1))
    parts = {name.split(".")[0] for name, _ in dynamics.named_parameters()}
    assert parts == {"stem", "layers", "output"}


@pytest.mark.parametrize("memory", [True, False])
def test_the_equations_with_product(memory: bool) -> None:
    """One step of the docstring, with the heading's features."""
    dynamics = network(architecture(memory))
    values = inputs(dynamics)
    values["offset"] = values["offset"][:, :, :1]
    s0, i0, h0 = values["s0"][0], values["inputs"][0, :, 0], values["hidden"][0]
    values["inputs"] = values["inputs"][:, :, :1]
    weights = {name: value[0] for name, value in dynamics.named_parameters()}
    psi = s0[:, 2] * float(units().state_scale[2]) + float(units().state_mean[2])
    waves = torch.stack([psi.sin(), psi.cos(), (2 * psi).sin(), (2 * psi).cos()], -1)
    x = torch.cat([s0, waves, i0], -1)
    u, v = (x @ weights["stem.weight"] + weights["stem.bias"]).chunk(2, -1)
    p = y = u * silu(v)
    if memory:
        gates = torch.cat([x, p], -1) @ weights["gates.weight"] + weights["gates.bias"]
        x_n, x_r, x_u = gates.chunk(3, -1)
        h_r, h_u, h_n = (h0 @ weights["gates_of_hidden.weight"]).chunk(3, -1)
        n = torch.tanh(x_n + torch.sigmoid(x_r + h_r) * (h_n + weights["hidden_bias"]))
        update = torch.sigmoid(x_u + h_u)
        hidden = (1 - update) * n + update * h0
        y = p + torch.cat([hidden, p], -1) @ weights["mix.weight"] + weights["mix.bias"]
    for layer in range(2):
        y = y + silu(y @ weights[f"layers.{layer}.weight"] + weights[f"layers.{layer}.bias"])
    assert weights["start_skip.weight"].abs().min() > 1e-3
    output = x @ weights["skip.weight"] + s0 @ weights["start_skip.weight"]
    output = output + y @ weights["output.weight"] + weights["output.bias"]
    expected = s0 + values["offset"][0, :, 0] + torch.from_numpy(units().delta_std) * output
    torch.testing.assert_close(dynamics.rollout(**values)[0][0, :, 0], expected)
