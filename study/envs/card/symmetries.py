"""The section of a page about the symmetries of a system: what is transformed, and how exactly."""

from collections.abc import Iterable

from study.config.names import markdown
from study.data.symmetries import Mirror, Symmetries, Turn
from study.envs.check_symmetries import TOLERANCE, SymmetryCheck, check_symmetries
from study.envs.simulator import Simulator

SECTION = """\
### Symmetries of the {title}

On the nominal system, a transformed rollout is the rollout of the transformed start and actions.
With noise, both have the same distribution. The setting `train.symmetries` applies the
transformations to training data.

{table}
"""

MEASURED = """
`study.check_simulator` compares {scenarios} rollouts of the nominal system before and after each
kind of transformation. The difference is in standard deviations of a component. A scenario is left
out if rounding alone changes its rollout by more than {tolerance:g}.{events}

| transformation | largest difference | scenarios left out |
|---|---|---|
{rows}

"""
BROKEN_BY = """
Turns by any angle also leave out scenarios with this event: {events}."""


def symmetries(simulator: Simulator) -> str:
    """The section; empty for a system without symmetries.

    Raises:
        CheckFailed: a rollout does not have a symmetry that the system declares.
    """
    checks = check_symmetries(simulator)
    return describe(simulator) + measured(simulator, checks) if checks else ""


def describe(simulator: Simulator) -> str:
    """The heading, and the table of the transformations."""
    rows = [f"| {' | '.join(map(markdown, row))} |" for row in _rows(simulator.symmetries)]
    head = ["| transformation | states | actions | goal |", "|---|---|---|---|"]
    return SECTION.format(title=markdown(simulator.title), table="\n".join([*head, *rows]))


def measured(simulator: Simulator, checks: list[SymmetryCheck]) -> str:
    """How exactly the symmetries hold."""
    events = ", ".join(simulator.symmetries.turn.broken_by)
    return MEASURED.format(
        scenarios=checks[0].scenarios,
        tolerance=TOLERANCE,
        events=BROKEN_BY.format(events=events) if events else "",
        rows="\n".join(
            f"| {check.name} | {check.difference:.1g} | {check.left_out} |" for check in checks
        ),
    )


def _rows(symmetries: Symmetries) -> Iterable[tuple[str, str, str, str]]:
    """Transformation, and what becomes of the states, the actions and the goal."""
    turn, mirror = symmetries.turn, symmetries.mirror
    if turn != Turn():
        angle = "a quarter turn, a half turn, …" if turn.quarter else "any angle φ"
        angles = [f"{name} + φ" for name in turn.angles]
        yield (
            f"turn by {angle}",
            _list([*_pairs(turn.states), *angles]),
            _list(_pairs(turn.actions)),
            _list(_pairs(turn.goal)),
        )
    if mirror != Mirror():
        groups = (mirror.states, mirror.actions, mirror.goal)
        states, actions, goal = (_list([f"−{name}" for name in names]) for names in groups)
        yield "mirror", states, actions, goal
    for shift in symmetries.shifts:
        moved = (_list([f"{name} + d" for name in names]) for names in (shift.states, shift.goal))
        states, goal = moved
        yield f"shift by d, {shift.low:g} to {shift.high:g}", states, "–", goal


def _pairs(pairs: Iterable[tuple[str, str]]) -> list[str]:
    return [f"({first}, {second})" for first, second in pairs]


def _list(entries: list[str]) -> str:
    return ", ".join(entries) or "–"
