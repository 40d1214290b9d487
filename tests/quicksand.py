"""An environment that fails, if the environment variable QUICKSAND says how."""

import os

from study.data.trajectories import Floats
from study.envs import Rollout, simulators
from study.seeds import Seeds
from tests.toys import Cart


@simulators.register("quicksand")
class Quicksand(Cart):
    """The cart, which now and then sinks."""

    name = "quicksand"

    def rollout(self, s0: Floats, actions: Floats, seeds: Seeds, noise: bool = True) -> Rollout:
        if os.environ.get("QUICKSAND") == "raise":
            raise FloatingPointError("the cart sank")
        if os.environ.get("QUICKSAND") == "exit":
            os._exit(7)
        return super().rollout(s0, actions, seeds, noise)
