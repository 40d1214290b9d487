"""The recording of a cell's forecasts: some scenarios, chosen by a rule, looked at closely."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from study.common.arrays import Doubles, Floats, Integers
from study.plotting.palette import FORECAST, OBSERVED
from study.recording import bands, blueprints, fans, scenes, spread
from study.recording.properties import Properties, write_markdown, write_readme
from study.recording.streams import entity_path, recording, send_scalars, style_lines

if TYPE_CHECKING:
    from study.envs.simulator import Simulator

KIND = "forecast"
TIMELINE = "horizon"
FANS = 20
"""So many paths are drawn of what was observed, and of the forecast; the bands are of all."""


README = """
# Forecasts

Each tab is one scenario of the test set, chosen by the rule that its panel states. From the same
beginning s₀ and the same actions a₀ … a_{T−1}, the real system was run K times (**observed**, grey)
and the model forecast K times (**forecast**, blue). A perfect model's blue is spread like the grey.
"""
_HOW_TO_READ = """
**Grey** is observed, **blue** is forecast: K runs each from the same beginning, with the same
actions. A perfect forecast is spread like the observed: neither wider nor narrower.

- *3D*: their paths; dots mark where they are at the time cursor. **Green** is the target and how
  close to it counts as success. The scene, and the **yellow** dot, follow one observed run.
- *Probability*: how many have come close enough so far.
- *State*: the outer lines hold 5–95 %, the inner ones 25–75 %; the thick line is the median.
"""
_OF_MEMBERS = """
## The ensemble

In 3D each of the {members} members has a colour: its own forecast is **thick**, the samples around
it are **thin**. How far the thick lie apart is *epistemic*: what the model does not know. How far
the thin lie from their thick one is *aleatoric*: the noise that it foresees.
"""
_OF_SPLIT = """
*Spread of position* shows both parts as standard deviations (variances add: total² = epistemic² +
aleatoric²). Observed runs differ by noise alone, so the aleatoric line (**yellow**) should lie on
the observed (**grey**); the epistemic one (**vermilion**) shrinks with more data.
"""


@dataclass(frozen=True)
class Example:
    """One scenario to look at.

    Attributes:
        scenario: its index in the test set; None if it was not chosen there by a rule.
        rule: why it was chosen, or what it is; what stands before a colon names its tab.
        s0: [D].
        actions: [T, A].
        goal: [G].
        observed: [K, T, D], the states s_1 … s_T that were observed.
        forecast: [K, T, D], the states that were forecast.
        member: [K] int, the ensemble member behind each forecast, or None; where a pair of members
            is behind it, m of the pair is `member` mod M.
        members: [M, T, D], the members' own forecasts, without noise, or None.
        aleatoric: [T] m², the aleatoric part of the variance that is forecast for the position,
            summed over its axes; None without an ensemble.
        epistemic: [T] m², the epistemic part.
    """

    scenario: int | None
    rule: str
    s0: Floats
    actions: Floats
    goal: Floats
    observed: Floats
    forecast: Floats
    member: Integers | None = None
    members: Floats | None = None
    aleatoric: Doubles | None = None
    epistemic: Doubles | None = None

    @property
    def title(self) -> str:
        """The tab's title."""
        return self.rule.split(":")[0].strip()[:32] or f"scenario {self.scenario}"

    @property
    def is_split(self) -> bool:
        """Whether the variance that is forecast is split into aleatoric and epistemic."""
        return self.aleatoric is not None and self.epistemic is not None


def record_forecast(
    path: Path,
    simulator: "Simulator",
    examples: Sequence[Example],
    properties: Properties,
    readme: str = README,
    notes: str = "",
) -> None:
    """Write the recording of some scenarios' forecasts.

    Args:
        path: the recording.
        simulator: the real system.
        examples: the scenarios, a tab each.
        properties: where the forecasts come from.
        readme: Markdown, what the recording is.
        notes: Markdown for the panel of each scenario, before how to read it.
    """
    titles = _titles(examples)
    roots = {title: entity_path(title.lower().replace(" ", "_")) for title in titles}
    quantiles = [(bands.quantiles(p.observed), bands.quantiles(p.forecast)) for p in examples]
    design = _design(simulator, examples, roots, quantiles)
    # Hundreds of small entities: an index of them would be larger than what it points to.
    with recording(path, KIND, properties, design, footer=False) as stream:
        write_readme(stream, readme, properties)
        model = simulator.scene()
        fixed = scenes.fixed_bodies(model)
        scenes.log_bodies(stream, "/scene", model, fixed)
        if examples:
            scenes.log_poses(
                stream, "/scene", model, fixed, simulator.configuration(examples[0].s0)
            )
        for root, example, (observed, forecast) in zip(
            roots.values(), examples, quantiles, strict=True
        ):
            _log_about(stream, root, simulator, example, notes)
            _log_scene(stream, f"{root}/scene", simulator, model, example)
            fans.log_paths(
                stream,
                f"{root}/paths",
                simulator,
                example.goal,
                example.observed[:FANS],
                example.forecast[:FANS],
                None if example.member is None else example.member[:FANS],
                example.members,
            )
            _log_success(stream, f"{root}/success", simulator, example)
            if example.aleatoric is not None and example.epistemic is not None:
                seen = simulator.position(example.observed)
                spread.log_spread(
                    stream, f"{root}/spread", seen, example.aleatoric, example.epistemic
                )
            for dimension, variable in enumerate(simulator.state):
                entity = entity_path(*root.strip("/").split("/"), "state", variable.name)
                bands.log_bands(stream, entity, observed[..., dimension], forecast[..., dimension])


def success_so_far(simulator: "Simulator", states: Floats, goal: Floats) -> Doubles:
    """The share [T] of trajectories [K, T, D] that have succeeded at or before each step."""
    with np.errstate(invalid="ignore", over="ignore"):
        distance = np.linalg.norm(simulator.position(states) - simulator.target(goal), axis=-1)
        close = distance <= simulator.radius
    return np.asarray(np.maximum.accumulate(close, axis=-1).mean(axis=0))


def _titles(examples: Sequence[Example]) -> list[str]:
    """The tabs' titles; the second of one name is numbered."""
    titles: list[str] = []
    for example in examples:
        count = sum(title.rstrip("0123456789 ") == example.title for title in titles)
        titles.append(example.title if not count else f"{example.title} {count + 1}")
    return titles


def _design(
    simulator: "Simulator",
    examples: Sequence[Example],
    roots: dict[str, str],
    quantiles: Sequence[tuple[Doubles, Doubles]],
) -> rrb.Blueprint:
    views: dict[str, list[tuple[str, str, tuple[float, float] | None]]] = {}
    eyes: dict[str, rrb.EyeControls3D] = {}
    for root, example, (observed, forecast) in zip(
        roots.values(), examples, quantiles, strict=True
    ):
        views[root] = [
            (
                bands.title(variable),
                entity_path(*root.strip("/").split("/"), "state", variable.name),
                bands.axis_range(observed[..., dimension], forecast[..., dimension]),
            )
            for dimension, variable in enumerate(simulator.state)
        ]
        eyes[root] = fans.eye(
            simulator.position(example.observed[:FANS]), simulator.target(example.goal)
        )
    split = {
        root for root, example in zip(roots.values(), examples, strict=True) if example.is_split
    }
    return blueprints.forecast(roots, views, eyes, split)


def _log_about(
    stream: rr.RecordingStream, root: str, simulator: "Simulator", example: Example, notes: str
) -> None:
    observed = success_so_far(simulator, example.observed, example.goal)[-1]
    forecast = success_so_far(simulator, example.forecast, example.goal)[-1]
    seconds = simulator.control_step * len(example.actions)
    chosen = f"Scenario {example.scenario}, chosen by this rule: *{example.rule}*."
    text = (
        f"# {example.title}\n\n{f'*{example.rule}*' if example.scenario is None else chosen}\n\n"
        f"Success within {seconds:.3g} s ({len(example.actions)} steps): "
        f"**forecast {forecast:.0%}**, **observed {observed:.0%}** "
        f"of {len(example.forecast)} and {len(example.observed)} runs.\n\n"
        f"{notes and notes + chr(10) * 2}## How to read it\n{_HOW_TO_READ}"
    )
    if example.members is not None:
        text += _OF_MEMBERS.format(members=len(example.members))
    if example.is_split:
        text += _OF_SPLIT
    write_markdown(stream, f"{root}/about", text)


def _log_scene(
    stream: rr.RecordingStream, root: str, simulator: "Simulator", model: object, example: Example
) -> None:
    """The moving bodies: at s0 (time 0), then along the first observed run."""
    run = np.concatenate([example.s0[None], example.observed[0]])
    run = run[: _finite_rows(run)]
    moving = scenes.moving_bodies(model)
    scenes.log_bodies(stream, root, model, moving)
    qpos = simulator.configuration(run)
    scenes.log_motion(stream, root, model, moving, qpos, TIMELINE, np.arange(len(run)))


def _finite_rows(states: Floats) -> int:
    """How many rows [T, D] there are before the first that is not finite; at least one."""
    lost = ~np.isfinite(states).all(axis=-1)
    return max(1, int(lost.argmax())) if lost.any() else len(states)


def _log_success(
    stream: rr.RecordingStream, root: str, simulator: "Simulator", example: Example
) -> None:
    for name, states, colour, width in (
        ("observed", example.observed, OBSERVED, 2.0),
        ("forecast", example.forecast, FORECAST, 3.0),
    ):
        share = success_so_far(simulator, states, example.goal)
        style_lines(stream, f"{root}/{name}", [name], [colour], width)
        send_scalars(stream, f"{root}/{name}", TIMELINE, np.arange(1, len(share) + 1), share)
