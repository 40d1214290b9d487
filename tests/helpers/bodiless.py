"""The cart of the tutorial without a MuJoCo scene, and a model whose forecasts are too narrow."""

import mujoco
import numpy as np
from torch import Tensor

from study.common.arrays import Booleans, Floats
from study.data.symmetries import Mirror, Symmetries
from study.envs import Variable, register
from study.examples.cart import Cart
from study.examples.drift import Drift
from study.models import models


@register("bodiless")
class Bodiless(Cart):
    """A cart that cannot be drawn, with text that LaTeX and Markdown have to escape."""

    name, title = "bodiless", "50%_a&b#c$d"
    action = (Variable("f|_x", "N<&>", "push |*| 100%", -1.0, 1.0),)
    symmetries = Symmetries(mirror=Mirror(states=("x", "v"), actions=("f|_x",), goal=("target",)))

    def scene(self) -> mujoco.MjModel | None:
        return None

    def outcomes(self, states: Floats, goal: Floats) -> dict[str, Booleans]:
        is_right = np.asarray((states[..., 0] > 0).any(axis=-1))
        return super().outcomes(states, goal) | {"50%_a&b#c$d|": is_right}


@register("faceless")
class Faceless(Cart):
    """A cart whose scene cannot be read."""

    name, title = "faceless", "Faceless"

    def scene(self) -> mujoco.MjModel | None:
        return mujoco.MjModel.from_xml_path("nowhere.xml")


@models.register("narrow")
class Narrow(Drift):
    """Forecasts of one dimension, which would be broadcast to all."""

    def sample(self, s0: Tensor, actions: Tensor, noise: Tensor, member: Tensor) -> Tensor:
        return super().sample(s0, actions, noise, member)[..., :1]
