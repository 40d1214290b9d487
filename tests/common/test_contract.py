"""Calls of a user's methods."""

import random

import pytest

from study.common.contract import CheckFailed, call


def test_another_thread_may_use_the_global_generator_during_a_call() -> None:
    uses = iter([True])

    def method() -> int:
        if next(uses, False):
            random.random()  # what a thread of a Dask worker does meanwhile
        return 3

    assert call("Cart.rollout", method) == 3


def test_a_method_that_uses_the_global_generator_uses_it_in_every_call() -> None:
    with pytest.raises(
        CheckFailed, match=r"^a\.b used the global random generator of Python; take"
    ):
        call("a.b", random.random)
