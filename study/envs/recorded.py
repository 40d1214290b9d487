"""A recorded system: logs in place of a simulator. Each of its scenarios was observed once.

It has what evaluation and recordings ask of a real system: variables, outcomes and positions. It
cannot simulate, so it has no oracle, no repeated rollouts and no policy.
"""

from collections.abc import Iterator, Mapping
from importlib.metadata import version
from typing import Any, NoReturn

import numpy as np

from study import __version__
from study.common.arrays import Booleans, Floats
from study.common.errors import BadInput, StudyError
from study.common.progress import Progress
from study.common.seeds import Seeds
from study.config.names import label
from study.config.recorded import Recorded
from study.config.settings import Collect
from study.data.readers import digests, files_of
from study.data.recorded.description import Description
from study.data.recorded.pieces import control_step
from study.data.recorded.windows import Split, Windows, read_windows
from study.data.trajectories import ScenarioSet, Trajectories
from study.data.variables import to_json
from study.envs.simulator import Episode, Policy, Scenarios, Simulator, simulators


class RecordedSystem(Simulator):
    """A system that is known by its logs alone.

    Args:
        name: of its section.
        settings: the section.
        horizon: number of control steps T; None is that of the section.
        step: seconds of a control step; 0 if it is not known.

    Raises:
        BadInput: a setting cannot be used.
    """

    has_target = False
    radius = 0.0

    def __init__(
        self, name: str, settings: Recorded, horizon: int | None = None, step: float = 0.0
    ) -> None:
        self.description = Description(name, settings)
        self.description.check()
        system: Any = self  # instances have what a simulator has on its class
        system.name, system.title = name, label(name)
        system.state, system.action = self.description.state, self.description.action
        system.goal = self.description.goal
        system.plotted = settings.plotted
        system.has_position = bool(settings.position)
        units = {v.unit for v in self.state if v.name in settings.position}
        system.position_unit = units.pop() if len(units) == 1 else "mixed units"
        system.rotating_pairs = self.description.rotating_pairs
        system.symmetries = self.description.symmetries
        system.default_horizon = settings.horizon
        system.control_step = settings.control_step or settings.interval or step
        super().__init__(horizon)

    def position(self, states: Floats) -> Floats:
        """Positions [..., 3]; zero where the settings name no axis."""
        names = [variable.name for variable in self.state]
        position = np.zeros((*states.shape[:-1], 3), states.dtype)
        for axis, name in enumerate(self.description.settings.position):
            position[..., axis] = states[..., names.index(name)]
        return position

    def target(self, goal: Floats) -> Floats:
        """No target: the origin."""
        return np.zeros((*goal.shape[:-1], 3), np.float32)

    def reached(self, states: Floats, goal: Floats) -> Booleans:
        """Whether the main outcome holds for the part of the trajectory up to each step."""
        conditions = self.description.conditions
        if not conditions:
            return np.zeros(states.shape[:-1], bool)
        main = next(iter(conditions.values()))
        return main.so_far(self.description.values(states, goal))

    def outcome(self, states: Floats, goal: Floats) -> Booleans:
        """Whether the main outcome happens, [...]."""
        return np.asarray(self.reached(states, goal)[..., -1])

    def outcomes(self, states: Floats, goal: Floats) -> dict[str, Booleans]:
        """The outcomes of the settings, by name, [...] each."""
        values = self.description.values(states, goal)
        return {
            name: np.asarray(condition.so_far(values)[..., -1])
            for name, condition in self.description.conditions.items()
        }

    def sample_scenarios(self, seeds: Seeds) -> Scenarios:
        """Not possible."""
        self._refuse()

    def start_episode(
        self, s0: Floats, seeds: Seeds | None = None, noise_steps: int = 1
    ) -> Episode:
        """Not possible."""
        self._refuse()

    def policy(self, scenarios: Scenarios, seeds: Seeds) -> Policy:
        """Not possible."""
        self._refuse()

    def _refuse(self) -> NoReturn:
        raise StudyError(f"{self.name} is a recorded system; it cannot be simulated")


def check(name: str, settings: Recorded) -> type[RecordedSystem]:
    """The class of a recorded system whose settings were checked.

    Raises:
        BadInput: a setting cannot be used, or a simulator has the name.
    """
    if name in simulators:
        raise BadInput(
            f"grid.environments: '{name}' is a simulator of the study; give another name to the "
            "section of the logs"
        )
    Description(name, settings).check()
    return RecordedSystem


def windows_of(name: str, settings: Recorded, collect: Collect, progress: Progress) -> Split:
    """All windows of a recorded system; see `read_windows`.

    Args:
        name: of the section.
        settings: the section.
        collect: its horizon overrides that of the section; the number of validation and test
            windows is at most `validation` and `scenarios`.
        progress: called after each log.
    """
    most = {"validation": collect.validation, "test": collect.scenarios}
    horizon = collect.horizon or settings.horizon
    return read_windows(Description(name, settings), horizon, collect.seed, most, progress)


def facts_of(name: str, settings: Recorded, split: Split, seed: int) -> dict[str, Any]:
    """The facts that the files of a recorded data set hold; see `Trajectories.facts`."""
    system = Description(name, settings)
    return {
        "environment": name,
        "environment_version": 1,
        "control_step": control_step(system, split.files),
        "state": to_json(system.state),
        "action": to_json(system.action),
        "unobserved": [],
        "goal": to_json(system.goal),
        "rotating_pairs": [list(names) for names in system.rotating_pairs],
        "symmetries": system.symmetries.to_json(),
        "seed": seed,
        "files": digests(list(split.files)),
        "split": {side: dict(windows.trajectories) for side, windows in split.windows.items()},
        "versions": {"study": __version__, "numpy": version("numpy")},
    }


def training_of(windows: Windows, facts: dict[str, Any]) -> Iterator[Trajectories]:
    """The training windows, chunk by chunk."""
    for states, actions, goal in windows.parts():
        yield Trajectories(states, actions, goal, np.empty((len(goal), 0), np.float32), facts)


def scenarios_of(windows: Windows, facts: dict[str, Any]) -> Iterator[ScenarioSet]:
    """Validation or test windows as scenarios with one observed rollout, chunk by chunk."""
    for states, actions, goal in windows.parts():
        unobserved = np.empty((len(goal), 1, 0), np.float32)
        yield ScenarioSet(states[:, 0], actions, goal, states[:, None, 1:], unobserved, facts)


def log_digests(name: str, settings: Recorded) -> Mapping[str, str]:
    """The SHA-256 of each log, by its path."""
    return digests(files_of(settings.files, f"{name}.files"))
