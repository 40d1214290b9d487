"""An environment that fails in the way that the environment variable QUICKSAND names."""

import os

from study.common.arrays import Floats
from study.common.seeds import Seeds
from study.envs import Rollout, register
from study.examples.cart import Cart


@register("quicksand")
class Quicksand(Cart):
    """The cart of the tutorial; a rollout can raise an error or end the process."""

    name, title = "quicksand", "Quicksand"

    def rollout(self, s0: Floats, actions: Floats, seeds: Seeds | None = None) -> Rollout:
        if os.environ.get("QUICKSAND") == "raise":
            raise FloatingPointError("the cart sank")
        if os.environ.get("QUICKSAND") == "exit":
            os._exit(7)
        return super().rollout(s0, actions, seeds)
