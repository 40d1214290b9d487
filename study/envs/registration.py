"""How an environment joins: one decorator registers it with the study and with Gymnasium."""

from collections.abc import Callable
from typing import TypeVar

import gymnasium

from study.envs.simulator import Simulator, simulators

SimulatorType = TypeVar("SimulatorType", bound=type[Simulator])


def register(name: str) -> Callable[[SimulatorType], SimulatorType]:
    """Decorator: register a simulator as `simulators[name]`, and with Gymnasium.

    Raises:
        ValueError: another class has that name already.
    """

    def enter(simulator: SimulatorType) -> SimulatorType:
        simulators.register(name)(simulator)
        environment = gymnasium_id(simulator)
        # The same source may be imported twice, as a plugin and by a test.
        if environment not in gymnasium.registry:
            entry_point = "study.envs.gymnasium_env:SimulatorEnv"
            gymnasium.register(environment, entry_point, kwargs={"simulator": name})
        return simulator

    return enter


def gymnasium_id(simulator: type[Simulator]) -> str:
    """The simulator's id in Gymnasium, such as ``study/Pusher-v0``."""
    return f"study/{simulator.title}-v0"
