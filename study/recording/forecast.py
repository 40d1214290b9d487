"""``forecast.rrd``: the observed and forecast trajectories of some examples of a cell."""

from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from study.common.arrays import Doubles, Floats
from study.envs.simulator import Simulator
from study.plotting.palette import FORECAST, OBSERVED
from study.recording import bands, blueprints, paths, scenes, viewpoint
from study.recording.examples import Example
from study.recording.properties import Properties, write_markdown, write_readme
from study.recording.recorded import README as README_RECORDED
from study.recording.recorded import recorded_about
from study.recording.streams import (
    entity_below,
    entity_path,
    recording,
    send_scalars,
    style_lines,
)
from study.recording.variance_split import log_variance_split

KIND = "forecast"
TIMELINE = "horizon"
PATHS = 20
"""Largest number of observed and of forecast paths in the 3D view. Other views use all samples."""


README = """
# Forecasts

Each tab shows one scenario of the test set. The panel on the left of the tab names the scenario and
the rule by which it was chosen. From the same initial state s₀ and the same actions a₀ … a_{T−1}:

- the real system was run several times (**observed**, grey);
- the model forecast K trajectories (**forecast**, blue).

A perfect forecast has the same distribution as the observed trajectories.
"""
_HOW_TO_READ = """
**Grey** is observed, **blue** is forecast. All trajectories start in the same state and follow the
same actions. A good forecast has the same variance as the observed trajectories.

- *Observed and forecast paths*: up to 20 observed and 20 forecast paths in the 3D scene. Small dots
  show some of the trajectories at the time cursor. **Green** is the target, and the sphere in which
  the goal counts as reached. The bodies and the **yellow** dot replay one observed trajectory.
- *Probability of success so far*: the share of trajectories that have reached the target by each
  step.
- *State*, on the right: one plot for each dimension of the state. The thick line is the median.
  Half of the trajectories are between the inner lines, and 90 % between the outer lines.
"""
_OF_MEMBERS = """
## The ensemble

The ensemble has {members} members: networks with different initial weights and the same training.
In 3D each member has a colour. A **thick** line is the forecast of a member without noise. The
**thin** lines of the same colour are its samples.

- *Epistemic* uncertainty is the difference between the thick lines. It comes from a lack of data.
- *Aleatoric* uncertainty is the distance of the thin lines from their thick line. It is the noise
  that the model expects.
"""
_OF_SPLIT = """
*Standard deviation of the position* shows both parts over the horizon. Variances add up:
total² = epistemic² + aleatoric². Observed trajectories differ by noise alone, so the aleatoric line
(**yellow**) should agree with the observed line (**grey**). The epistemic line (**vermilion**)
becomes lower with more data.
"""


def record_forecast(
    path: Path,
    simulator: Simulator,
    examples: Sequence[Example],
    properties: Properties,
    readme: str = README,
    notes: str = "",
) -> None:
    """Write the recording of some examples.

    The entity of an example has the name of its title. Below this entity, `/state/NAME` holds the
    quantiles of a dimension. `/success/observed` and `/success/forecast` hold the probability of
    success so far, and `/position_std` the standard deviation of the position. The timeline is
    `horizon`, from 1 to T.

    Args:
        path: the recording.
        simulator: the real system.
        examples: the examples, with a tab for each.
        properties: of the recording.
        readme: Markdown of the README panel.
        notes: Markdown before the explanation in the panel of each example.
    """
    titles = _titles(examples)
    roots = {title: entity_path(title.lower().replace(" ", "_")) for title in titles}
    quantiles = [(bands.quantiles(e.observed), bands.quantiles(e.forecast)) for e in examples]
    design = _design(simulator, examples, roots, quantiles)
    # The index of hundreds of small entities would be larger than their data.
    with recording(path, KIND, properties, design, footer=False) as stream:
        write_readme(stream, readme if simulator.has_target else README_RECORDED, properties)
        model = simulator.scene()
        if examples:
            scenes.log_fixed(stream, simulator, model, examples[0].s0)
        for root, example, (observed, forecast) in zip(
            roots.values(), examples, quantiles, strict=True
        ):
            _log_about(stream, root, simulator, example, notes)
            _log_example(stream, root, simulator, model, example)
            for dimension, variable in enumerate(simulator.state):
                entity = entity_below(root, "state", variable.name)
                bands.log_bands(stream, entity, observed[..., dimension], forecast[..., dimension])


def success_so_far(simulator: Simulator, states: Floats, goal: Floats) -> Doubles:
    """The share [T] of trajectories that have reached the target at or before each step.

    Args:
        simulator: computes position and target, and has the radius of the target.
        states: [K, T, D] in SI units.
        goal: [G] in SI units.
    """
    if not len(states):
        return np.full(states.shape[1], np.nan)
    with np.errstate(invalid="ignore", over="ignore"):
        return np.asarray(simulator.reached(states, goal).mean(axis=0))


def _titles(examples: Sequence[Example]) -> list[str]:
    """The title of each tab; equal titles are numbered from the second on."""
    titles: list[str] = []
    for example in examples:
        title = example.title[:32]
        count = sum(previous.rstrip("0123456789 ") == title for previous in titles)
        titles.append(f"{title} {count + 1}" if count else title)
    return titles


def _is_split(example: Example) -> bool:
    """Whether the forecast's variance is split into aleatoric and epistemic."""
    return example.aleatoric is not None and example.epistemic is not None


def _design(
    simulator: Simulator,
    examples: Sequence[Example],
    roots: dict[str, str],
    quantiles: Sequence[tuple[Doubles, Doubles]],
) -> rrb.Blueprint:
    """The layout, with an axis for each plot of bands and an eye for each scene."""
    views: dict[str, list[blueprints.Band]] = {}
    eyes: dict[str, rrb.EyeControls3D] = {}
    for root, example, (observed, forecast) in zip(
        roots.values(), examples, quantiles, strict=True
    ):
        views[root] = [
            (
                bands.title(variable),
                entity_below(root, "state", variable.name),
                bands.axis_range(observed[..., dimension], forecast[..., dimension]),
            )
            for dimension, variable in enumerate(simulator.state)
        ]
        if simulator.has_position:
            eyes[root] = _eye(simulator, example)
    split = {root for root, e in zip(roots.values(), examples, strict=True) if _is_split(e)}
    has_outcomes = all(_has_outcomes(simulator, example) for example in examples)
    unit = simulator.position_unit
    return blueprints.forecast(roots, views, eyes, split, has_outcomes, unit)


def _has_outcomes(simulator: Simulator, example: Example) -> bool:
    """Whether the system has outcomes; every simulator has."""
    return bool(simulator.outcomes(example.s0[None], example.goal))


def _eye(simulator: Simulator, example: Example) -> rrb.EyeControls3D:
    """An eye with the observed paths in view; without them, the forecast paths."""
    states = example.observed if len(example.observed) else example.forecast
    target = simulator.target(example.goal)
    if not simulator.has_target:
        target = simulator.position(example.s0)
    return viewpoint.eye(simulator.position(states[:PATHS]), target)


def _log_about(
    stream: rr.RecordingStream, root: str, simulator: Simulator, example: Example, notes: str
) -> None:
    """Log the panel of an example: its origin, its outcome, and how to read its views."""
    if not simulator.has_target:
        about = recorded_about(simulator, example, notes)
        write_markdown(stream, f"{root}/about", about)
        return
    observed = success_so_far(simulator, example.observed, example.goal)[-1]
    forecast = success_so_far(simulator, example.forecast, example.goal)[-1]
    seconds = simulator.control_step * len(example.actions)
    text = (
        f"# {example.title}\n\n{example.description}\n\n"
        f"Probability of success within {seconds:.3g} s ({len(example.actions)} steps): "
        f"**forecast {forecast:.0%}** ({len(example.forecast)} samples), "
        f"**observed {observed:.0%}** ({len(example.observed)} rollouts).\n\n"
    )
    if notes:
        text += f"{notes}\n\n"
    text += f"## How to read it\n{_HOW_TO_READ}"
    if example.members is not None:
        text += _OF_MEMBERS.format(members=len(example.members))
    if _is_split(example):
        text += _OF_SPLIT
    write_markdown(stream, f"{root}/about", text)


def _log_example(
    stream: rr.RecordingStream,
    root: str,
    simulator: Simulator,
    model: mujoco.MjModel | None,
    example: Example,
) -> None:
    """Log all views of an example but its bands: scene, paths, success and standard deviation."""
    if simulator.has_position:
        if len(example.observed):
            _log_scene(stream, f"{root}/scene", simulator, model, example)
        paths.log_scenario(
            stream,
            f"{root}/paths",
            simulator,
            example.goal,
            example.observed[:PATHS],
            example.forecast[:PATHS],
            None if example.member is None else example.member[:PATHS],
            example.members,
        )
    if _has_outcomes(simulator, example):
        _log_success(stream, f"{root}/success", simulator, example)
    if example.aleatoric is not None and example.epistemic is not None:
        position = simulator.position(example.observed)
        entity = f"{root}/position_std"
        log_variance_split(stream, entity, position, example.aleatoric, example.epistemic)


def _log_scene(
    stream: rr.RecordingStream,
    root: str,
    simulator: Simulator,
    model: mujoco.MjModel | None,
    example: Example,
) -> None:
    """Log the moving bodies, in s_0 at time 0 and then along the first observed trajectory."""
    states = np.concatenate([example.s0[None], example.observed[0]])
    states = states[: scenes.finite_steps(states)]
    scenes.log_moving(stream, root, simulator, model, states, TIMELINE)


def _log_success(
    stream: rr.RecordingStream, root: str, simulator: Simulator, example: Example
) -> None:
    """Log the probability of success so far, observed and forecast."""
    for name, states, colour, width in (
        ("observed", example.observed, OBSERVED, 2.0),
        ("forecast", example.forecast, FORECAST, 3.0),
    ):
        share = success_so_far(simulator, states, example.goal)
        style_lines(stream, f"{root}/{name}", [name], [colour], width)
        send_scalars(stream, f"{root}/{name}", TIMELINE, np.arange(1, len(share) + 1), share)
