"""Mean and standard deviation of more numbers than fit into memory."""

from collections.abc import Callable, Iterable

import numpy as np

from study.common.arrays import Array, Doubles


def moments(parts: Callable[[], Iterable[Array]]) -> tuple[Doubles, Doubles]:
    """Mean [D] and standard deviation [D] over all axes but the last, in double precision.

    The sums run through the numbers in their order, so the result does not depend on how they are
    parted, and is that of ``mean`` and ``std`` of the whole.

    Args:
        parts: gives the numbers [..., D] part by part, the same each time: it is called twice.
    """
    count, total = _sum(parts, lambda rows: rows)
    mean = total / count
    _, squares = _sum(parts, lambda rows: np.square(rows - mean))
    return mean, np.sqrt(squares / count)


def _sum(
    parts: Callable[[], Iterable[Array]], term: Callable[[Doubles], Doubles]
) -> tuple[int, Doubles]:
    """Number of rows, and the sum of the terms [D]."""
    count, total = 0, np.zeros(())
    for part in parts():
        terms = term(part.reshape(-1, part.shape[-1]).astype(np.float64))
        terms[0] += total
        total = terms.sum(axis=0)
        count += len(terms)
    return count, total
