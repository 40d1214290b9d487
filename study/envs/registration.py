"""How an environment joins: one decorator registers it with the study and with Gymnasium."""

import re
from collections.abc import Callable
from numbers import Integral, Real
from typing import Any, TypeVar

import gymnasium
import numpy as np

from study.common.errors import BadInput
from study.common.registry import full_name, identity, missing
from study.data.symmetries import Symmetries
from study.data.variables import Variable
from study.envs.simulator import Simulator, simulators

SimulatorType = TypeVar("SimulatorType", bound=type[Simulator])

REQUIRED = (
    "name",
    "title",
    "state",
    "action",
    "goal",
    "default_horizon",
    "control_step",
    "radius",
)
"""Attributes without a default."""


def register(name: str) -> Callable[[SimulatorType], SimulatorType]:
    """Decorator: register a simulator as `simulators[name]`, and with Gymnasium.

    Raises:
        BadInput: the name cannot be used, another class has the name or the title already, or the
            class lacks an attribute or a method.
    """

    def enter(simulator: SimulatorType) -> SimulatorType:
        check_class(simulator)
        if simulator.name != name:
            raise BadInput(
                f"{full_name(simulator)}.name: got '{simulator.name}'; it is registered as '{name}'"
            )
        environment = gymnasium_id(simulator)
        for other in map(simulators.__getitem__, simulators):
            if gymnasium_id(other) == environment and identity(other) != identity(simulator):
                raise BadInput(
                    f"{full_name(simulator)}: {full_name(other)} has the title '{other.title}' "
                    f"and is registered as '{other.name}'; give another title and name"
                )
        simulators.register(name)(simulator)
        # The same source may be imported twice, as a plugin and by a test.
        if environment not in gymnasium.registry:
            entry_point = "study.envs.gymnasium_env:SimulatorEnv"
            gymnasium.register(environment, entry_point, kwargs={"simulator": name})
        return simulator

    return enter


def gymnasium_id(simulator: type[Simulator]) -> str:
    """The simulator's id in Gymnasium, such as ``study/Pusher-v0``.

    Characters of the title that Gymnasium does not allow become hyphens.
    """
    return f"study/{_without_symbols(simulator.title)}-v0"


def check_class(simulator: Any) -> None:
    """Check what can be known of a class without an instance.

    Raises:
        BadInput: it is no simulator, or lacks an attribute or a method.
    """
    subject = full_name(simulator)
    if not (isinstance(simulator, type) and issubclass(simulator, Simulator)):
        raise BadInput(f"{subject} is not a subclass of study.envs.Simulator")
    if lacks := missing(simulator, REQUIRED):
        raise BadInput(f"{subject} lacks {', '.join(lacks)}: see study.envs.Simulator")
    for name in ("state", "action", "goal", "unobserved"):
        variables = getattr(simulator, name)
        if not isinstance(variables, tuple) or not all(isinstance(v, Variable) for v in variables):
            raise BadInput(
                f"{subject}.{name}: got {variables!r:.60}; it must be a tuple of Variable"
            )
        names = [variable.name for variable in variables]
        if len(set(names)) < len(names):
            raise BadInput(f"{subject}.{name}: got {names}; each variable has a name of its own")
        if not names and name in ("state", "action"):
            raise BadInput(f"{subject}.{name} is empty; give at least one Variable")
    if not isinstance(simulator.symmetries, Symmetries):
        raise BadInput(
            f"{subject}.symmetries: got {simulator.symmetries!r:.60}; give study.envs.Symmetries"
        )
    simulator.symmetries.check(
        f"{subject}.symmetries",
        *([v.name for v in group] for group in (simulator.state, simulator.action, simulator.goal)),
    )
    for variable in simulator.action:
        if not -np.inf < variable.low < variable.high < np.inf:
            raise BadInput(
                f"{subject}.action: '{variable.name}' is between {variable.low} and "
                f"{variable.high}; it needs two finite bounds, the lower one first"
            )
    numbers: tuple[tuple[str, Any, str], ...] = (
        ("default_horizon", Integral, "whole number"),
        ("control_step", Real, "number"),
        ("radius", Real, "number"),
    )
    for name, kinds, wanted in numbers:
        value = getattr(simulator, name)
        if not isinstance(value, kinds) or not 0 < float(value) < np.inf:
            raise BadInput(f"{subject}.{name}: got {value!r:.60}; it must be a positive {wanted}")
    if not isinstance(simulator.title, str) or not _without_symbols(simulator.title):
        raise BadInput(f"{subject}.title: got {simulator.title!r:.60}; it needs a letter or digit")


def _without_symbols(title: str) -> str:
    return re.sub(r"[^A-Za-z0-9_.]+", "-", title).strip("-")
