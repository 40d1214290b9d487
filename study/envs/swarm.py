"""Many copies of a small model in one MuJoCo world.

A call of `mj_step` has a fixed cost that outweighs the physics of a small system. Copies in one
world pay this cost once. Copies never touch, so each moves exactly as it would alone.
"""

from copy import copy
from functools import cache
from pathlib import Path

import mujoco


def swarm(path: Path, count: int) -> mujoco.MjModel:
    """A world with `count` copies of the model at `path`, without what only pictures need.

    The qpos, qvel and ctrl of the copies follow one another, copy by copy.
    """
    return copy(_compiled(path, count))


@cache
def _compiled(path: Path, count: int) -> mujoco.MjModel:
    one, world = mujoco.MjSpec.from_file(str(path)), mujoco.MjSpec()
    _strip(one)
    world.option, world.visual = one.option, one.visual
    for number in range(count):
        world.attach(one.copy(), prefix=f"{number}_", frame=world.worldbody.add_frame())
    return world.compile()


def _strip(spec: mujoco.MjSpec) -> None:
    """Remove everything without effect on the motion."""
    touching = {name for pair in spec.pairs for name in (pair.geomname1, pair.geomname2)}
    for geom in spec.geoms:
        fixed = geom.parent.name == spec.worldbody.name
        if geom.name not in touching and (fixed or geom.parent.explicitinertial):
            spec.delete(geom)
    for decoration in (*spec.lights, *spec.cameras, *spec.sites, *spec.textures, *spec.materials):
        spec.delete(decoration)
