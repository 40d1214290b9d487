"""The settings of a recorded system: logs of a robot in place of a simulator.

A section of the YAML file whose name stands in ``grid.environments`` describes the logs::

    grid:
      environments: [my_robot]
    my_robot:
      files: ["logs/*.csv"]
      state: ["x [m]", "v = velocity.x [m/s]"]
      action: [throttle]
      interval: 0.1
      outcomes: ["passes the gate = x > 3 at any step"]
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from study.common.errors import BadInput, shown
from study.common.registry import check_name
from study.config.sections import register_systems, registered, setting
from study.config.settings import SECTIONS, Config

MARK = "files"
"""The setting that tells the section of a recorded system from a misspelt section."""


DEGREES = ("deg", "degree", "degrees", "°")
"""Units of angles that are converted to rad."""


@dataclass(frozen=True)
class Recorded:
    """Logs, and what their columns mean.

    A variable is written ``NAME = COLUMN [UNIT]``; ``NAME =`` and ``[UNIT]`` may be left out.

    Args:
        files: paths or patterns of logs, such as ``logs/*.csv``, relative to the working folder.
        format: csv, parquet, minari, ulog, ros or lerobot; null is by the ending of each file.
        state: the state variables.
        action: the action variables; the action of a row leads to the state of the next row.
        goal: variables that only outcomes use; a window has their values at its first step.
        trajectory: column that names the trajectory of a row; null is one trajectory a file, or the
            episodes of the format.
        reset: column that is not zero in the first row of each trajectory.
        time: column of the time, numbers or dates; null is that of the format, if it has one.
        time_unit: of a time column of numbers: s, ms, us or ns.
        interval: seconds from one row to the next, for logs without a time column.
        control_step: seconds between states; the logs are resampled to it. null keeps the rows.
        largest_gap: seconds without a row beyond which the time jumps; null is five intervals, or
            two control steps if these are longer.
        breaks: what a jump of the time or a non-finite value does: it is an error, or it splits the
            trajectory.
        longest_trajectory: seconds; longer trajectories are cut into pieces of this length. The
            pieces of one log can then be on both sides of a split.
        exclude: rows in which one of these conditions holds are left out. In them ``t`` is the time
            in seconds since the log began.
        horizon: control steps T of a window; collect.horizon overrides it.
        stride: steps from the start of one training window to the next.
        test_stride: the same for validation and test windows; null is the horizon, so that these
            windows do not overlap.
        validation: share of the trajectories for validation.
        test: share of the trajectories for the test.
        angles: state variables that are angles, in rad, or in degrees with the unit ``[deg]``.
        angles_as: an angle is unwrapped and begins within ±π, or is replaced by its sine and
            cosine.
        position: two or three state variables that recordings draw in space; empty draws none.
        plotted: state variables that figures plot; empty lets the figure choose.
        outcomes: conditions such as ``arrives = hypot(x, y) < 0.5 at any step``, the main one
            first. A condition holds ``at any step``, ``at every step`` or ``at the end``.
        turn: pairs of variables that turn together about the vertical, such as ``x y``.
        turn_angles: state variables to which the angle of a turn is added.
        mirror: variables that change their sign in a mirror image.
        shifts: variables that can be shifted together, and the largest amount: ``x goal_x = 20``.
        rotating_pairs: ``a b angle``: a and b are components along axes that the angle rotates.
    """

    files: tuple[str, ...] = ()
    format: str | None = setting(
        None, choices=("csv", "parquet", "minari", "ulog", "ros", "lerobot")
    )
    state: tuple[str, ...] = ()
    action: tuple[str, ...] = ()
    goal: tuple[str, ...] = ()
    trajectory: str | None = None
    reset: str | None = None
    time: str | None = None
    time_unit: str = setting("s", choices=("s", "ms", "us", "ns"))
    interval: float | None = setting(None, low=1e-9)
    control_step: float | None = setting(None, low=1e-9)
    largest_gap: float | None = setting(None, low=1e-9)
    breaks: str = setting("error", choices=("error", "split"))
    longest_trajectory: float | None = setting(None, low=1e-9)
    exclude: tuple[str, ...] = ()
    horizon: int = setting(50, low=2, high=10**4)
    stride: int = setting(10, low=1, high=10**6)
    test_stride: int | None = setting(None, low=1, high=10**6)
    validation: float = setting(0.15, low=1e-6, high=0.9)
    test: float = setting(0.15, low=1e-6, high=0.9)
    angles: tuple[str, ...] = ()
    angles_as: str = setting("unwrapped", choices=("unwrapped", "sine_cosine"))
    position: tuple[str, ...] = ()
    plotted: tuple[str, ...] = ()
    outcomes: tuple[str, ...] = ()
    turn: tuple[str, ...] = ()
    turn_angles: tuple[str, ...] = ()
    mirror: tuple[str, ...] = ()
    shifts: tuple[str, ...] = ()
    rotating_pairs: tuple[str, ...] = ()

    def of_data(self) -> "Recorded":
        """The settings on which the data set depends: those without outcomes and pictures."""
        return replace(self, outcomes=(), position=(), plotted=())


@dataclass(frozen=True)
class Column:
    """A variable of a recorded system.

    Attributes:
        name: of the variable.
        column: of the logs.
        unit: SI unit; ``1`` if none is given.
    """

    name: str
    column: str
    unit: str

    @property
    def in_degrees(self) -> bool:
        """Whether the logs have an angle in degrees."""
        return self.unit in DEGREES

    @classmethod
    def parse(cls, text: str) -> "Column":
        """The variable in a text ``NAME = COLUMN [UNIT]``.

        Raises:
            BadInput: the text has no column.
        """
        rest, _, unit = text.strip().partition(" [")
        if unit and not unit.endswith("]"):
            raise BadInput(f"got {shown(text)}; a variable is written NAME = COLUMN [UNIT]")
        name, equals, column = (part.strip() for part in rest.rpartition("="))
        if not column or (equals and not name):
            raise BadInput(f"got {shown(text)}; a variable is written NAME = COLUMN [UNIT]")
        return cls(name or column, column, unit[:-1].strip() or "1")


def columns(section: str, settings: Recorded, group: str) -> tuple[Column, ...]:
    """The variables of a group of settings: state, action or goal.

    Raises:
        BadInput: one cannot be read, or two have the same name.
    """
    found: list[Column] = []
    for text in getattr(settings, group):
        try:
            column = Column.parse(text)
        except BadInput as error:
            raise BadInput(f"{section}.{group}: {error}") from None
        if column.name in [other.name for other in found]:
            raise BadInput(f"{section}.{group}: '{column.name}' is named twice; name it once")
        found.append(column)
    return tuple(found)


def register_recorded(content: Mapping[str, Any]) -> None:
    """Register the sections of recorded systems among the sections of a configuration file.

    Raises:
        BadInput: the name of a section cannot name an environment.
    """
    grid = content.get("grid")
    environments = grid.get("environments", ()) if isinstance(grid, Mapping) else ()
    names = []
    for name, section in content.items():
        if not isinstance(section, Mapping) or name in SECTIONS:
            continue
        if registered().get(name, Recorded) is not Recorded:  # the section of a model
            continue
        is_named = isinstance(environments, list | tuple) and name in environments
        if MARK in section or is_named:
            check_name("recorded system", name, "grid.environments")
            names.append(name)
    register_systems(names, Recorded)


def recorded_of(config: Config, environment: str) -> Recorded | None:
    """The settings of a recorded system; None if the environment is a simulator."""
    section = config.sections.get(environment)
    return section if isinstance(section, Recorded) else None
