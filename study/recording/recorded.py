"""The texts of a forecast recording of a recorded system, whose scenarios were observed once."""

import numpy as np

from study.envs.simulator import Simulator
from study.recording.examples import Example

README = """
# Forecasts

Each tab shows one window of the test logs, or a plan. From its initial state s₀ and its actions
a₀ … a_{T−1} the model forecast K trajectories (**forecast**, blue). The log has one trajectory
(**observed**, grey). It cannot show the noise of the system: of many windows, 90 % of the observed
values should be within the outer lines of the forecast.
"""
_HOW_TO_READ = """
**Grey** is observed, **blue** is forecast. All trajectories start in the same state and follow the
same actions.

{paths}{outcome}- *State*: one plot for each dimension. The thick blue line is the median of the
  forecasts. Half of the forecasts are between the inner lines, and 90 % between the outer lines.
"""
_PATHS = "- *Observed and forecast paths*: the position in space.\n"
_OUTCOME = (
    "- *Probability of success so far*: the share of forecasts in which the main outcome, "
    "*{name}*, holds for the part up to each step.\n"
)
_OF_MEMBERS = """
## The ensemble

The ensemble has {members} members: networks with different initial weights and the same training.
*Epistemic* uncertainty is the difference between members. It comes from a lack of data. *Aleatoric*
uncertainty is the variance of one member's forecasts. It is the noise that the model expects.
"""


def recorded_about(simulator: Simulator, example: Example, notes: str) -> str:
    """The panel of an example: its origin, its outcomes, and how to read its views.

    Args:
        simulator: the recorded system.
        example: with one observed trajectory, or with none.
        notes: Markdown before the explanation.
    """
    with np.errstate(invalid="ignore", over="ignore"):
        forecast = simulator.outcomes(example.forecast, example.goal[None])
        observed = simulator.outcomes(example.observed, example.goal[None])
    lines = []
    for name, happens in forecast.items():
        seen = observed[name]
        logged = f", observed **{'yes' if seen[0] else 'no'}**" if len(seen) else ""
        lines.append(f"- {name}: forecast **{happens.mean():.0%}**{logged}\n")
    steps = len(example.actions)
    text = (
        f"# {example.title}\n\n{example.description}\n\n"
        f"{len(example.forecast)} forecasts of {simulator.control_step * steps:.3g} s ({steps} "
        f"steps).\n\n"
    )
    text += f"## Outcomes\n\n{''.join(lines)}\n" if lines and not notes else ""
    text += f"{notes}\n\n" if notes else ""
    how = _HOW_TO_READ.format(
        paths=_PATHS if simulator.has_position else "",
        outcome=_OUTCOME.format(name=next(iter(forecast))) if forecast else "",
    )
    text += f"## How to read it\n{how}"
    if example.members is not None:
        text += _OF_MEMBERS.format(members=len(example.members))
    return text
