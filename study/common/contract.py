"""Shared code of the checks of a user's classes. Each failure is one line."""

import pickle
import random
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np

from study.common.arrays import Array
from study.common.errors import StudyError
from study.common.plugins import reason

TOLERANCE = 1e-4
"""Numbers that differ by less, relative to the largest, are the same to rounding."""

ATTEMPTS = 3
"""Calls before a method counts as a user of a global random generator. Another thread of the
process, such as that of a Dask worker, may use Python's generator during one call."""


class CheckFailed(StudyError):
    """A class does not do what the study relies on: names the class, the method and the fault."""


def call(subject: str, function: Callable[..., Any], *arguments: Any, seeded: bool = True) -> Any:
    """Call a method of the user.

    Args:
        subject: the class and the method, for errors.
        function: the method.
        arguments: its arguments. It must leave arrays and tensors as they are.
        seeded: whether the method must not use a global random generator.

    Raises:
        CheckFailed: the method raises, changes an argument or uses a global generator.
    """
    copies = [_copy(value) for value in arguments]
    for _ in range(ATTEMPTS):
        result, used = _call(subject, function, arguments)
        if not (seeded and used):
            break
    else:
        raise CheckFailed(
            f"{subject} used the global random generator of {used[0]}; "
            "take every random number from the seeds or the noise of the arguments"
        )
    for position, (value, copy) in enumerate(zip(arguments, copies, strict=True), start=1):
        if copy is not None and np.asarray(value).tobytes() != copy.tobytes():
            raise CheckFailed(f"{subject} changed its argument {position} in place; copy it first")
    return result


def _call(
    subject: str, function: Callable[..., Any], arguments: tuple[Any, ...]
) -> tuple[Any, list[str]]:
    """The result of a call, and the libraries whose global random generator changed meanwhile."""
    before = _generators()
    try:
        result = function(*arguments)
    except StudyError:
        raise
    except Exception as error:
        raise CheckFailed(f"{subject} raised {reason(error)}") from error
    after = _generators()
    changed = [
        name
        for name, state in after.items()
        if pickle.dumps(state) != pickle.dumps(before.get(name, state))
    ]
    return result, changed


def expect_array(
    subject: str, value: Any, shape: tuple[int, ...], dtype: type | None = np.float32
) -> None:
    """Check type, shape, type of the elements, and that all are finite.

    Args:
        subject: the class and the method.
        value: what the method returned.
        shape: the shape that is wanted.
        dtype: the type of the elements; None for any floating-point type.

    Raises:
        CheckFailed: the value is another one.
    """
    if not isinstance(value, np.ndarray):
        raise CheckFailed(f"{subject} returned {_kind(value)}, wanted an array {list(shape)}")
    if value.shape != shape:
        raise CheckFailed(f"{subject} returned {list(value.shape)}, wanted {list(shape)}")
    kinds = np.floating if dtype is None else dtype
    if not np.issubdtype(value.dtype, kinds):
        wanted = "floats" if dtype is None else np.dtype(dtype).name
        raise CheckFailed(f"{subject} returned {value.dtype}, wanted {wanted}")
    if not np.isfinite(value).all():
        lost = np.argwhere(~np.isfinite(value))
        first = ", ".join(map(str, lost[0]))
        raise CheckFailed(
            f"{subject} returned {value[tuple(lost[0])]} at [{first}] "
            f"({len(lost)} of {value.size} values are not finite)"
        )


def expect_same(subject: str, one: Array, other: Array, difference: str) -> None:
    """Check that two results agree to rounding.

    Args:
        subject: the class and the method.
        one: a result.
        other: what it has to be.
        difference: ends the error, ``SUBJECT returned other numbers DIFFERENCE``.

    Raises:
        CheckFailed: the results differ.
    """
    size = max(1.0, float(np.abs(np.asarray(other, np.float64)).max(initial=0.0)))
    if not np.allclose(one, other, rtol=TOLERANCE, atol=TOLERANCE * size):
        raise CheckFailed(f"{subject} returned other numbers {difference}")


@contextmanager
def preserved_generators() -> Iterator[None]:
    """Leave the global random generators in the state in which they are."""
    states, torch = _generators(), sys.modules.get("torch")
    try:
        yield
    finally:
        random.setstate(states["Python"])
        np.random.set_state(states["NumPy"])  # noqa: NPY002
        if torch is not None and "torch" in states:
            torch.set_rng_state(torch.from_numpy(states["torch"]))


def _generators() -> Mapping[str, Any]:
    """The states of the global random generators, by library."""
    states: dict[str, Any] = {
        "Python": random.getstate(),
        "NumPy": np.random.get_state(),  # noqa: NPY002
    }
    torch = sys.modules.get("torch")  # a system that does not import it cannot use it
    return states if torch is None else states | {"torch": torch.get_rng_state().numpy()}


def _copy(value: Any) -> Array | None:
    is_tensor = hasattr(value, "detach")
    return np.asarray(value).copy() if isinstance(value, np.ndarray) or is_tensor else None


def _kind(value: Any) -> str:
    return "None" if value is None else f"a {type(value).__name__}"
