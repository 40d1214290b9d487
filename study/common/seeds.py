"""Seeds: every random number of the study comes from a seed with a name.

A seed depends on what it is for and on nothing else, never on batch size, order or worker.
"""

import hashlib

import numpy as np
from numpy.typing import NDArray

Seeds = NDArray[np.uint64]


def derive(*path: str | int) -> int:
    """The seed of one purpose: `derive(0, "pusher", "test")` is the same number everywhere."""
    text = "/".join(map(str, path))
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "little")


def spawn(seed: int, count: int) -> Seeds:
    """`count` seeds [count] from one. The first n of them do not depend on `count`."""
    return np.asarray(np.random.SeedSequence(seed).generate_state(count, np.uint64), np.uint64)


def torch_seed(seed: int) -> int:
    """A seed in the range that Lightning and torch accept."""
    return seed % (2**32)
