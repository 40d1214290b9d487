"""Mean and standard deviation of arrays that do not fit into memory."""

from collections.abc import Callable, Iterable

import numpy as np

from study.common.arrays import Array, Doubles


def moments(read_parts: Callable[[], Iterable[Array]]) -> tuple[Doubles, Doubles]:
    """Mean [D] and standard deviation [D] over all axes but the last, in double precision.

    The rows are summed in their order. So the result does not depend on the division into parts,
    and equals ``mean`` and ``std`` of the whole array bit for bit.

    Args:
        read_parts: returns the array [..., D] part by part. It is called twice, and must return
            the same parts both times.
    """
    count, total = _sum(read_parts, lambda rows: rows)
    mean = total / count
    _, squares = _sum(read_parts, lambda rows: np.square(rows - mean))
    return mean, np.sqrt(squares / count)


def _sum(
    read_parts: Callable[[], Iterable[Array]], term: Callable[[Doubles], Doubles]
) -> tuple[int, Doubles]:
    """Number of rows, and the sum of their terms [D]."""
    count, total = 0, np.zeros(())
    for part in read_parts():
        terms = term(part.reshape(-1, part.shape[-1]).astype(np.float64))
        terms[0] += total
        total = terms.sum(axis=0)
        count += len(terms)
    return count, total
