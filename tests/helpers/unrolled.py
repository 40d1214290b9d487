"""Random arguments of `unroll`, in the precision of one's choice."""

from dataclasses import dataclass, fields, replace
from typing import Any

import torch
from torch import Tensor

from study.models.unroll.unroll import Weights, torch_unroll, unroll


@dataclass(frozen=True)
class Sizes:
    """M, B, T, D, K, P, H, L and Q."""

    networks: int
    batch: int
    steps: int
    state: int
    angles: int
    stem: int
    memory: int
    layers: int
    pairs: int = 0

    def width(self) -> int:
        return self.stem or self.memory


@dataclass(frozen=True)
class Case:
    """Arguments of `unroll`."""

    weights: Weights
    terms: Tensor
    state: Tensor
    hidden: Tensor
    gain: Tensor | None
    noise: Tensor | None

    def to(self, dtype: torch.dtype) -> "Case":
        """The same numbers in another precision."""

        def convert(value: Tensor | None) -> Any:
            return value if value is None or not value.is_floating_point() else value.to(dtype)

        weights = Weights(*(convert(value) for value in self.weights.tensors()))
        inputs: list[Any] = [convert(getattr(self, entry.name)) for entry in fields(self)[1:]]
        return Case(weights, *inputs)

    def rows(self, part: slice) -> "Case":
        """Some of the trajectories."""
        rows: list[Any] = [getattr(self, entry.name) for entry in fields(self)[1:]]
        rows = [value if value is None else value[:, part] for value in rows]
        return Case(self.weights, *rows)

    def unroll(self, decay: float = 1.0, return_tops: bool = True) -> tuple[Tensor, Tensor]:
        inputs = (self.terms, self.state, self.hidden, self.gain, self.noise)
        return unroll(self.weights, *inputs, decay, return_tops)

    def torch_unroll(self, decay: float = 1.0) -> tuple[Tensor, Tensor]:
        inputs = (self.terms, self.state, self.hidden, self.gain, self.noise)
        return torch_unroll(self.weights, *inputs, decay)

    def differentiable(self) -> list[Tensor]:
        """The arguments that have a gradient, which from now on is computed."""
        inputs = (self.terms, self.state, self.hidden, self.gain)
        tensors = [value for value in (*self.weights.tensors()[:10], *inputs) if value is not None]
        return [value.requires_grad_() for value in tensors]


def case(sizes: Sizes, gain: bool = False, noise: bool = False) -> Case:
    """Random arguments in float64, without bounds of the state."""
    generator = torch.Generator().manual_seed(0)
    m, d, k, p, h = sizes.networks, sizes.state, sizes.angles, sizes.stem, sizes.memory
    w, layers, rows = sizes.width(), sizes.layers, (m, sizes.batch, sizes.steps)
    f, o = d + 4 * k, d + 2 * p + 3 * h

    def normal(*shape: int, std: float = 0.5 * w**-0.5) -> Tensor:
        # A sum over the units is of order one, so that gates do not saturate.
        return torch.randn(shape, generator=generator, dtype=torch.float64) * std

    angles = torch.arange(k).flip(0) * 2 % max(d, 1)
    columns = torch.tensor([column for column in range(d) if column not in angles.tolist()])
    pairs = columns[torch.randperm(len(columns), generator=torch.Generator().manual_seed(0))]
    pairs = pairs[: 2 * sizes.pairs].view(-1, 2).long()

    weights = Weights(
        state=normal(m, f, o),
        gates=normal(m, p, 3 * h),
        hidden=normal(m, h, 3 * h),
        hidden_bias=normal(m, h),
        mix=normal(m, h + p, p) if h and p else normal(m, 0, 0),
        mix_bias=normal(m, p) if h and p else normal(m, 0),
        layers=normal(m, layers, w, w),
        layers_bias=normal(m, layers, w),
        output=normal(m, w, d),
        noise_output=normal(m, w, d) if gain else None,
        # Large enough to reach the bound.
        log_std=normal(m, w, d, std=3.0) if noise else None,
        log_std_bias=normal(m, d, std=1.0) if noise else None,
        lowest=torch.full((d,), -torch.inf, dtype=torch.float64),
        highest=torch.full((d,), torch.inf, dtype=torch.float64),
        angle_columns=angles,
        angle_mean=normal(k, std=1.0),
        angle_scale=normal(k, std=1.0),
        pair_columns=pairs,
        # The canonical frame's axis points from the last pair to the first.
        axis_columns=pairs[[-1, 0]] if sizes.pairs else pairs,
        axis_scale=normal(2 if sizes.pairs else 0, std=1.0),
    )
    return Case(
        weights,
        terms=normal(*rows, o),
        state=normal(m, sizes.batch, d, std=1.0),
        hidden=normal(m, sizes.batch, h),
        gain=normal(*rows, w, std=1.0) if gain else None,
        noise=normal(*rows, d, std=1.0) if noise else None,
    )


def bounded(arguments: Case) -> Case:
    """The same with bounds that some of the states reach."""
    states, _ = arguments.torch_unroll()
    lowest, highest = states.flatten(0, 2).quantile(torch.tensor([0.3, 0.7]).double(), dim=0)
    weights = replace(arguments.weights, lowest=lowest, highest=highest)
    result = replace(arguments, weights=weights)
    states, _ = result.torch_unroll()
    at_bound = (states == lowest) | (states == highest)
    assert 0.1 < at_bound.double().mean() < 0.9
    return result
