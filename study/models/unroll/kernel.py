"""The functions of `unroll.c`, compiled on first use.

There is no library without a C compiler, or with ``STUDY_COMPILED=0`` in the environment.
`study.models.unroll.unroll` then computes the same in torch.
"""

import ctypes
import logging
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from study.models.unroll import compiler

if TYPE_CHECKING:
    from study.models.unroll.unroll import Weights

SOURCES = tuple(
    Path(__file__).with_name(name) for name in ("unroll.c", "layout.h", "pointwise.h", "vectors.h")
)
"""The C file, and the headers that it includes."""
ROWS = 12
"""Number of trajectories of a block, as in the source."""

_log = logging.getLogger(__name__)


class Sizes(ctypes.Structure):
    """The structure `Sizes` of the source, and the layout of its arrays."""

    _fields_ = (
        *((name, ctypes.c_long) for name in ("batch", "steps", "state", "angles")),
        *((name, ctypes.c_long) for name in ("stem", "memory", "layers", "pairs")),
        ("decay", ctypes.c_float),
        ("bound", ctypes.c_float),
    )
    state: int
    angles: int
    stem: int
    memory: int
    layers: int
    pairs: int
    batch: int
    steps: int

    @classmethod
    def of(cls, weights: "Weights", batch: int, steps: int, decay: float, bound: float) -> "Sizes":
        """The sizes of weights, and of a batch."""
        state, angles = len(weights.lowest), len(weights.angle_columns)
        stem, memory = weights.gates.shape[1], weights.hidden.shape[1]
        layers, pairs = weights.layers.shape[1], len(weights.pair_columns)
        return cls(batch, steps, state, angles, stem, memory, layers, pairs, decay, bound)

    @property
    def width(self) -> int:
        """W."""
        return self.stem or self.memory

    @property
    def has_mix(self) -> bool:
        """Whether the network has both a stem and memory."""
        return bool(self.stem and self.memory)

    def _tape(self) -> list[int]:
        h, p, w = self.memory, self.stem, self.width
        features = self.state + 4 * self.angles
        frame = 3 + self.state if self.pairs else 0
        return [features, h, h, p, p, p, 4 * h, (self.layers + 1) * w, self.layers * w, frame]

    def tape_size(self) -> int:
        """Numbers in the tape for each step."""
        return sum(self._tape())

    def split_tape(self, tape: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor, list[Tensor]]:
        """f, h_t, p, [h_{t+1}, p] and y_0 … y_L, all [..., size], from the tape [..., size]."""
        features, before, after, stem, _, _, _, tops, _, _ = tape.split(self._tape(), -1)
        start = features.shape[-1] + before.shape[-1]
        mixed = tape[..., start : start + after.shape[-1] + stem.shape[-1]]
        return features, before, stem, mixed, list(tops.split(self.width, -1))

    def gradients_size(self) -> int:
        """Numbers in the gradients for each step."""
        terms = self.state + 2 * self.stem + 3 * self.memory
        return terms + self.memory + self.stem + self.layers * self.width

    def split_gradients(
        self, gradients: Tensor
    ) -> tuple[Tensor, Tensor, Tensor, Tensor, list[Tensor]]:
        """Those of the terms, the gates n, r, u, the gates r, u, n, the mix and the layers."""
        h, first = self.memory, self.state + 2 * self.stem
        mix = first + 4 * h
        sums = mix + self.stem
        return (
            gradients[..., : first + 3 * h],
            gradients[..., first : first + 3 * h],
            gradients[..., first + h : mix],
            gradients[..., mix:sums],
            list(gradients[..., sums:].split(self.width, -1)) if self.layers else [],
        )


def _structure(count: int) -> type[Any]:
    """A structure of `count` pointers."""
    fields = [(f"pointer_{index}", ctypes.c_void_p) for index in range(count)]
    return type("Pointers", (ctypes.Structure,), {"_fields_": fields})


_WEIGHTS, _INPUTS = _structure(20), _structure(5)
_ARRAYS = {"forward": 3, "backward": 8}


@cache
def library() -> ctypes.CDLL | None:
    """The compiled functions; None where they cannot be compiled."""
    if (path := compiler.find()) is None:
        return None
    try:
        compiled = ctypes.CDLL(str(compiler.build(*SOURCES, compiler=path)))
    except OSError as error:
        _log.warning("networks are unrolled in plain torch: %s", error)
        return None
    for name, arrays in _ARRAYS.items():
        function = getattr(compiled, name)
        function.argtypes = (ctypes.c_long,) * 2 + (ctypes.c_void_p,) * (3 + arrays)
        function.restype = None
    return compiled


def forward(
    sizes: Sizes,
    weights: "Weights",
    inputs: tuple[Tensor | None, ...],
    states: Tensor,
    tops: Tensor | None,
    tape: Tensor | None,
) -> None:
    """Call `forward` of the source; `inputs` are terms, state, hidden, gain and noise."""
    compiled = library()
    assert compiled is not None
    _call(compiled.forward, sizes, weights, inputs, (states, tops, tape))


def backward(
    sizes: Sizes,
    weights: "Weights",
    inputs: tuple[Tensor | None, ...],
    states: Tensor,
    tape: Tensor,
    grad_results: tuple[Tensor | None, ...],
    computed: tuple[Tensor | None, ...],
) -> None:
    """Call `backward` of the source.

    Args:
        sizes, weights, inputs, states, tape: see `forward`.
        grad_results: gradients of the states and of the tops; either may be None.
        computed: the arrays that the function writes, in the order of the source.
    """
    compiled = library()
    assert compiled is not None
    _call(compiled.backward, sizes, weights, inputs, (states, tape, *grad_results, *computed))


def _call(
    function: Callable[..., None],
    sizes: Sizes,
    weights: "Weights",
    inputs: tuple[Tensor | None, ...],
    arrays: tuple[Tensor | None, ...],
) -> None:
    """Call a function of the library for all blocks, on as many threads as torch uses."""
    structures = (
        sizes,
        _WEIGHTS(*_pointers(weights.tensors())),
        _INPUTS(*_pointers(inputs)),
    )
    pointers = [ctypes.addressof(structure) for structure in structures] + _pointers(arrays)
    blocks = len(weights.state) * -(-sizes.batch // ROWS)
    threads = min(torch.get_num_threads(), blocks)
    if threads < 2:
        function(0, blocks, *pointers)
        return
    bounds = [blocks * part // threads for part in range(threads + 1)]
    with ThreadPoolExecutor(threads) as pool:  # ctypes releases the interpreter's lock
        calls = [pool.submit(function, first, last, *pointers) for first, last in pairwise(bounds)]
    for finished in calls:
        finished.result()


def _pointers(arrays: Sequence[Tensor | None]) -> list[int | None]:
    for array in arrays:
        assert array is None or array.is_contiguous()
    return [None if array is None else array.data_ptr() for array in arrays]
