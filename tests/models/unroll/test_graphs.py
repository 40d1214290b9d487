"""CUDA graphs, played on the CPU: a fake capture has the same arrays at every replay."""

from collections.abc import Callable
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from study.models.unroll import graphs, kernel
from study.models.unroll.graphs import MOST_GRAPHS, Graphs, Results
from study.models.unroll.unroll import unroll
from tests.helpers.unrolled import Case, Sizes, case

SIZES = Sizes(2, 5, 4, 3, 1, 6, 6, 2)


class FakeCapture:
    """Like `torch.cuda.make_graphed_callables`: static arguments, results and gradients."""

    def __init__(self) -> None:
        self.captures, self.replays = 0, 0

    def __call__(
        self, function: Callable[..., Results], arguments: Results
    ) -> Callable[..., Results]:
        self.captures += 1
        outputs = function(*arguments)
        static = [output.detach().clone() for output in outputs]
        wanted = [value for value in arguments if value.requires_grad]
        static_gradients = [torch.zeros_like(value) for value in wanted]
        fake = self

        class Graphed(torch.autograd.Function):
            @staticmethod
            def forward(ctx: object, *inputs: Tensor) -> Results:
                fake.replays += 1
                for argument, value in zip(arguments, inputs, strict=True):
                    if argument.data_ptr() != value.data_ptr():
                        argument.copy_(value)
                with torch.no_grad():
                    for array, value in zip(static, function(*arguments), strict=True):
                        array.copy_(value)
                return tuple(array.detach() for array in static)

            @staticmethod
            def backward(ctx: object, *gradients: Tensor) -> tuple[Tensor | None, ...]:
                # The arguments are those of the last replay.
                with torch.enable_grad():
                    results = function(*arguments)
                found = torch.autograd.grad(results, wanted, gradients, allow_unused=True)
                returned: list[Tensor | None] = []
                for array, value in zip(static_gradients, found, strict=True):
                    if value is not None:
                        array.copy_(value)
                    # A parameter's gradient may be this array until the next replay.
                    returned.append(None if value is None else array.detach())
                rest = iter(returned)
                return tuple(next(rest) if v.requires_grad else None for v in arguments)

        return Graphed.apply


def double(values: Tensor, _: Tensor | None = None) -> Results:
    return (2 * values,)


def square(values: Tensor) -> Results:
    return (values.square(),)


@pytest.fixture
def fake() -> FakeCapture:
    return FakeCapture()


@pytest.fixture
def on_a_gpu(monkeypatch: pytest.MonkeyPatch, fake: FakeCapture) -> None:
    """Networks take the path of a GPU."""
    monkeypatch.setattr(kernel, "library", lambda: None)
    monkeypatch.setattr(graphs, "are_used", lambda device: True)
    monkeypatch.setattr(graphs, "cuda_capture", fake)


def test_a_shape_is_captured_at_its_second_use(fake: FakeCapture) -> None:
    captured = Graphs(fake)
    for use in range(4):
        values = torch.full((3,), float(use))
        assert torch.equal(captured(double, (values, None))[0], 2 * values)
    assert (fake.captures, fake.replays) == (1, 3)
    captured(double, (torch.ones(4), None))
    captured(double, (torch.ones(3), None), (0.5,))
    captured(double, (torch.ones(3).double(), None))
    captured(double, (torch.ones(3, requires_grad=True), None))
    assert (fake.captures, fake.replays) == (1, 3)


def test_inference_mode_has_graphs_of_its_own(fake: FakeCapture) -> None:
    """A forecast may be called in that mode. Its tensors cannot be written to outside of it."""
    captured = Graphs(fake)
    for _ in range(3):
        for mode in (torch.inference_mode, torch.no_grad):
            with mode():
                assert torch.equal(captured(double, (torch.ones(3),))[0], torch.full((3,), 2.0))
    assert (fake.captures, fake.replays) == (2, 4)


def test_a_gpu_captures_unless_the_environment_forbids_it(monkeypatch: pytest.MonkeyPatch) -> None:
    devices = [torch.device("cuda"), torch.device("cpu")]
    monkeypatch.delenv(graphs.SWITCH, raising=False)
    assert [graphs.are_used(device) for device in devices] == [True, False]
    monkeypatch.setenv(graphs.SWITCH, "0")
    assert [graphs.are_used(device) for device in devices] == [False, False]


def test_results_are_not_overwritten(fake: FakeCapture) -> None:
    captured = Graphs(fake)
    results = [captured(double, (torch.full((2,), float(use)),))[0] for use in range(4)]
    assert [float(result[0]) for result in results] == [0.0, 2.0, 4.0, 6.0]


def test_a_graph_whose_backward_pass_is_to_come_is_not_replayed(fake: FakeCapture) -> None:
    captured = Graphs(fake)
    for _ in range(3):
        inputs = [torch.full((2,), float(n), requires_grad=True) for n in (1, 2)]
        results = [captured(square, (value,))[0].sum() for value in inputs]
        torch.stack(results).sum().backward()
        assert [float(value.grad[0]) for value in inputs if value.grad is not None] == [2.0, 4.0]
    assert fake.replays == 3  # the others had to wait
    for _ in range(3):  # results without a backward pass block nothing
        captured(square, (torch.ones(2, requires_grad=True),))
    assert fake.replays == 6


def test_the_number_of_graphs_is_limited(fake: FakeCapture) -> None:
    captured = Graphs(fake)
    for size in range(1, MOST_GRAPHS + 4):
        for _ in range(3):
            assert len(captured(double, (torch.ones(size),))[0]) == size
    assert fake.captures == MOST_GRAPHS


def test_without_a_capture_the_function_runs_itself(caplog: pytest.LogCaptureFixture) -> None:
    def fails(*_: object) -> Callable[..., Results]:
        raise RuntimeError("operation not permitted when stream is capturing")

    captured = Graphs(fails)
    for _ in range(4):
        assert torch.equal(captured(double, (torch.ones(3),))[0], torch.full((3,), 2.0))
    assert [record.message for record in caplog.records] == [
        "no CUDA graph, sequences run step by step: "
        "operation not permitted when stream is capturing; STUDY_GRAPHS=0 turns graphs off"
    ]


@pytest.mark.parametrize("gain", [False, True])
@pytest.mark.parametrize("return_tops", [False, True])
@pytest.mark.parametrize("sizes", [SIZES, replace(SIZES, stem=0), replace(SIZES, memory=0)])
@pytest.mark.usefixtures("on_a_gpu")
def test_a_sequence(sizes: Sizes, gain: bool, return_tops: bool, fake: FakeCapture) -> None:
    """Values and gradients, with new weights and inputs at every replay."""
    owner = torch.nn.Module()
    for use in range(3):
        arguments = scaled(case(sizes, gain), 1 + 0.1 * use)
        inputs = arguments.differentiable()
        expected = arguments.torch_unroll(0.8)[: 1 + return_tops]
        rows = (arguments.terms, arguments.state, arguments.hidden, arguments.gain)
        results = unroll(arguments.weights, *rows, None, 0.8, return_tops, owner)
        found = results[: 1 + return_tops]
        for ours, theirs in zip(found, expected, strict=True):
            torch.testing.assert_close(ours, theirs)
        gradients = [
            torch.autograd.grad(
                sum(result.square().sum() for result in values),  # type: ignore[arg-type]
                inputs,
                allow_unused=True,
                materialize_grads=True,
            )
            for values in (found, expected)
        ]
        torch.testing.assert_close(*gradients)
    assert (fake.captures, fake.replays) == (1, 2)


def scaled(arguments: Case, factor: float) -> Case:
    """Other numbers of the same shapes."""
    weights = replace(arguments.weights, state=factor * arguments.weights.state)
    return replace(arguments, weights=weights, terms=factor * arguments.terms)


@pytest.mark.usefixtures("on_a_gpu")
def test_noise_is_no_part_of_the_graph(fake: FakeCapture) -> None:
    owner = torch.nn.Module()
    for use in range(3):
        arguments = case(SIZES, noise=True)
        noise = (1 + use) * arguments.noise if arguments.noise is not None else None
        arguments = replace(arguments, noise=noise)
        with torch.no_grad():
            rows = (arguments.terms, arguments.state, arguments.hidden, None, noise)
            found, _ = unroll(arguments.weights, *rows, owner=owner)
            torch.testing.assert_close(found, arguments.torch_unroll()[0])
    assert fake.replays == 2


@pytest.mark.usefixtures("on_a_gpu")
def test_the_graphs_of_a_network_are_removed_with_it() -> None:
    owner = torch.nn.Module()
    assert graphs.of(owner) is graphs.of(owner)
    count = len(graphs._graphs)
    del owner
    assert len(graphs._graphs) == count - 1
