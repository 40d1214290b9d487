"""How an environment joins: one decorator enters it into the study and into Gymnasium."""

from collections.abc import Callable
from typing import TypeVar

import gymnasium

from study.envs.simulator import Simulator, simulators

S = TypeVar("S", bound=type[Simulator])


def register(name: str) -> Callable[[S], S]:
    """Decorator: a simulator becomes `simulators[name]`, and ``study/{title}-v0`` in Gymnasium.

    Raises:
        ValueError: another class has that name already.
    """

    def enter(simulator: S) -> S:
        simulators.register(name)(simulator)
        environment = gymnasium_id(simulator)
        # The same source may be imported twice, as a plugin and by a test.
        if environment not in gymnasium.registry:
            entry_point = "study.envs.gymnasium_env:SimulatorEnv"
            gymnasium.register(environment, entry_point, kwargs={"simulator": name})
        return simulator

    return enter


def gymnasium_id(simulator: type[Simulator]) -> str:
    """The name under which Gymnasium makes it: ``study/Pusher-v0``."""
    return f"study/{simulator.title}-v0"
