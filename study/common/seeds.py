"""Seeds: every random number of the study comes from a named seed.

A seed depends on its name alone, never on batch size, order or worker.
"""

import hashlib

import numpy as np
from numpy.typing import NDArray

Seeds = NDArray[np.uint64]


def derive(*path: str | int) -> int:
    """The seed of a purpose: `derive(0, "pusher", "test")` is the same number on every machine."""
    text = "/".join(map(str, path))
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "little")


def spawn(seed: int, count: int) -> Seeds:
    """`count` seeds [count] from one seed. The first n seeds do not depend on `count`."""
    return np.asarray(np.random.SeedSequence(seed).generate_state(count, np.uint64), np.uint64)


def torch_seed(seed: int) -> int:
    """A seed in the range that Lightning and torch accept."""
    return seed % (2**32)
