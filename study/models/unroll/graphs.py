"""CUDA graphs: thousands of small operations on a GPU, launched at once.

A loop over the steps of a horizon starts some thirty operations a step, and so does a network of
single transitions. On a GPU each takes less time than its launch. A CUDA graph records the
operations, forwards and backwards, and replays them in one launch. It is bound to the shapes of its
arguments, so there is one for each shape.
"""

import logging
import os
import weakref
from collections import Counter
from collections.abc import Callable, Hashable
from itertools import chain
from typing import Any

import torch
from torch import Tensor, nn
from torch.func import functional_call

MOST_GRAPHS = 8
"""Largest number of graphs of one owner, since each keeps its arrays in the memory of the GPU."""
SWITCH = "STUDY_GRAPHS"
"""Environment variable. The value 0 turns graphs off."""

Results = tuple[Tensor, ...]
Capture = Callable[[Callable[..., Results], Results], Callable[..., Results]]

_log = logging.getLogger(__name__)


def are_used(device: torch.device) -> bool:
    """Whether functions on this device are captured."""
    return device.type == "cuda" and os.environ.get(SWITCH) != "0"


def cuda_capture(function: Callable[..., Results], arguments: Results) -> Callable[..., Results]:
    """A function that replays `function`. Its results are overwritten by the next replay.

    Args:
        function: of tensors, without synchronisation with the CPU.
        arguments: tensors of the graph. Calls of the result copy their arguments into them.
    """
    captured: Any = torch.cuda.make_graphed_callables(function, arguments, allow_unused_input=True)
    return captured


class Graphs:
    """The graphs of one network, by the shapes of the arguments.

    A shape is captured at its second use, since a capture takes as long as some ten calls. If a
    capture fails, that shape is never captured, and the function runs without a graph.

    Forward and backward pass of a graph share one set of arrays. If a result still needs its
    backward pass, the next call of the same shape runs without a graph.

    Args:
        capture: see `cuda_capture`.
    """

    def __init__(self, capture: Capture | None = None) -> None:
        self.capture = capture or cuda_capture
        self.uses: Counter[Hashable] = Counter()
        self.graphs: dict[Hashable, Callable[..., Results] | None] = {}
        self.last: dict[Hashable, weakref.ref[_Replay]] = {}

    def __call__(
        self,
        function: Callable[..., Results],
        arguments: tuple[Tensor | None, ...],
        constants: tuple[Hashable, ...] = (),
    ) -> Results:
        """`function(*arguments)`.

        Args:
            function: see `cuda_capture`; arguments that are None stay None.
            arguments: its arguments.
            constants: on what else it depends.
        """
        present = tuple(value for value in arguments if value is not None)
        grad = torch.is_grad_enabled()
        shapes = tuple(None if value is None else _shape(value, grad) for value in arguments)
        # Outside inference mode, nothing may write into the arrays of a graph of that mode.
        key = (shapes, constants, grad, torch.is_inference_mode_enabled())
        self.uses[key] += 1
        if key not in self.graphs and self.uses[key] > 1 and len(self.graphs) < MOST_GRAPHS:
            self.graphs[key] = self._captured(function, arguments, grad)
        graph = self.graphs.get(key)
        if graph is None or self._is_waiting(key):
            return function(*arguments)
        replay = _Replay()
        self.last[key] = weakref.ref(replay)
        copies: Results = _Copy.apply(replay, *graph(*present))
        return copies

    def _is_waiting(self, key: Hashable) -> bool:
        replay = self.last[key]() if key in self.last else None
        return replay is not None and not replay.is_done

    def _captured(
        self, function: Callable[..., Results], arguments: tuple[Tensor | None, ...], grad: bool
    ) -> Callable[..., Results] | None:
        static = tuple(_static(value, grad) for value in arguments if value is not None)
        are_present = [value is not None for value in arguments]

        def of_tensors(*tensors: Tensor) -> Results:
            values = iter(tensors)
            return function(*(next(values) if present else None for present in are_present))

        try:
            return self.capture(of_tensors, static)
        except RuntimeError as error:
            reason = f"{error}; {SWITCH}=0 turns graphs off"
            _log.warning("no CUDA graph, sequences run step by step: %s", reason)
            return None


class _Replay:
    """One replay. Autograd keeps it as long as its backward pass may be needed."""

    is_done = False
    """Whether the backward pass has begun."""


class _Copy(torch.autograd.Function):
    """Copies of the results, which the next replay overwrites."""

    @staticmethod
    def forward(ctx: Any, replay: _Replay, *results: Tensor) -> Results:
        ctx.replay = replay
        return tuple(result.clone() for result in results)

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        ctx.replay.is_done = True
        return None, *gradients


def _shape(value: Tensor, grad: bool) -> Hashable:
    return tuple(value.shape), value.dtype, value.device, grad and value.requires_grad


def _static(value: Tensor, grad: bool) -> Tensor:
    """The argument of a graph: a copy; or a parameter itself, which an optimiser changes in place.

    If a module has moved its parameter, the next call copies it to the old address.
    """
    static = value.detach() if isinstance(value, nn.Parameter) else value.detach().clone()
    return static.requires_grad_(grad and value.requires_grad)


_graphs: weakref.WeakKeyDictionary[Any, Graphs] = weakref.WeakKeyDictionary()


def of(owner: Any) -> Graphs:
    """The graphs of a network, which are removed with it."""
    return _graphs.setdefault(owner, Graphs())


def call(module: nn.Module, *arguments: Tensor) -> Results:
    """Call a module, in training on a GPU as a CUDA graph.

    Args:
        module: returns a tuple of tensors. It changes no buffer, and samples nothing.
        arguments: tensors.
    """
    device = arguments[0].device
    is_captured = are_used(device) and torch.is_grad_enabled()
    if not is_captured or torch.is_autocast_enabled(device.type):
        results: Results = module(*arguments)
        return results
    state = dict(chain(module.named_parameters(), module.named_buffers()))
    count = len(arguments)

    def function(*tensors: Tensor) -> Results:
        values = dict(zip(state, tensors[count:], strict=True))
        results: Results = functional_call(module, values, tensors[:count])
        return results

    return of(module)(function, (*arguments, *state.values()), ("call",))
