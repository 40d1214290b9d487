"""Write the page about environments: descriptions, pictures, measured facts and tables."""

import inspect
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from study import envs
from study.common.files import write_text
from study.common.progress import Progress
from study.common.seeds import derive
from study.config.names import markdown
from study.config.settings import Collect
from study.data.trajectories import ScenarioSet, concatenate
from study.data.variables import Constant, constants_table, variables_table
from study.envs import Simulator, gymnasium_id, simulators
from study.envs.card.facts import Facts, measure, rows
from study.envs.card.fans import PROBABILITIES, plot_fans, typical
from study.envs.card.filmstrip import plot_filmstrip
from study.envs.card.histogram import plot_histogram
from study.envs.card.symmetries import symmetries
from study.envs.check import check_foreign
from study.envs.observe import observe_scenarios, real_system

INTRODUCTION = """\
# The environments

An environment is a simulated system in which an agent tries to reach a goal, with noise. A scenario
can be simulated any number of times, so the true distribution of its outcome is known. The
environments do not depend on the forecasters and can be used without them:

```python
import gymnasium
from study.common.seeds import spawn
from study.envs import simulators
{registers}
# One trajectory, step by step.
env = gymnasium.make("{id}"{pictures})
observation, info = env.reset(seed=0)

# Many trajectories, with the same dynamics.
simulator = simulators["{name}"](threads=2)
seeds = spawn(0, 1000)
scenarios = simulator.sample_scenarios(seeds)
actions = simulator.plan(scenarios, seeds)
rollout = simulator.rollout(scenarios.s0, actions, seeds)  # rollout.states is [N, T+1, D]
```

- A **scenario** is an initial state and a goal.
- A **plan** is the action sequence of a policy in closed loop with the noise-free system.
- A **rollout** executes the plan open loop in the noisy system.

A scenario or a rollout depends on its own seed alone. Batch size, order and number of threads have
no effect.
"""

OF_THE_STUDY = """
The physics of the study's own environments runs in MuJoCo. The tests in `tests/envs/` compare it
with conservation laws, formulas and independent implementations, and the Gymnasium environments
with the batched simulators. The benchmarks in `tests/benchmarks/` measure the speed.

The command `portrait` writes a page like this one. The first line below writes this page, the
second one a page about an environment of `study/examples/`:

```
python -m study.run portrait --config configs/paper.yaml --to study/envs
python -m study.run portrait cart --plugins '[study.examples.cart]'
```
"""
"""Only of the environments that come with the study: not said of a user's."""

SECTION = """
## {title}

Gymnasium id: `{id}`

{filmstrip}{description}

### Uncertainty of the outcome of the {title}

![Histogram of the probability of success]({histogram})

![Rollouts of three scenarios]({fans})

*All rollouts of three scenarios, whose probabilities of success are close to {probabilities}.*

The numbers are of the test scenarios of data seed {seed}, with all their rollouts.

| quantity | value |
|---|---|
{facts}

{symmetries}{tables}
"""


FILMSTRIP = """\
![Filmstrip of the {title}]({filmstrip})

*One rollout, with the target and the path so far. The frame is green once the goal is reached.*

"""
"""Only of a system with a scene."""


def write_page(
    collect: Collect, names: Sequence[str], folder: Path, progress: Progress
) -> list[Path]:
    """Write ``README.md`` and its pictures into `folder`.

    The scenarios are those of the study's test set.

    Args:
        collect: number of scenarios and rollouts, and the seed.
        names: registered names of environments.
        folder: it is created if necessary.
        progress: called after each part of the work.

    Returns:
        The files.

    Raises:
        StudyError: OpenGL is not available, or a class does not do what the study relies on.
    """
    for name in names:
        check_foreign(simulators[name], collect.horizon)
    text = [introduction(names)]
    pictures: list[Path] = []
    for number, name in enumerate(names):
        part = progress.part(number / len(names), (number + 1) / len(names))
        simulator, seed = real_system(name, collect)
        scenarios = concatenate(
            observe_scenarios(
                simulator,
                collect.scenarios,
                collect.rollouts,
                derive(seed, "test"),
                part.part(0.0, 0.8),
            )
        )
        part(0.8, f"{name}: pictures")
        pictures += _plot(simulator, scenarios, folder)
        text.append(_section(simulator, measure(simulator, scenarios), collect.seed))
        part(1.0, name)
    page = folder / "README.md"
    write_text(page, "".join(text))
    return [page, *pictures]


def introduction(names: Sequence[str]) -> str:
    """The page without the sections of the environments `names`."""
    first = simulators[names[0]]
    modules = dict.fromkeys(simulators[name].__module__ for name in names)
    foreign = [module for module in modules if module.rpartition(".")[0] != envs.__name__]
    registers = "".join(f"import {module}  # registers its environment\n" for module in foreign)
    text = INTRODUCTION.format(
        id=gymnasium_id(first),
        name=first.name,
        registers=registers,
        pictures="" if first().scene() is None else ', render_mode="rgb_array"',
    )
    return text if foreign else text + OF_THE_STUDY


def describe(simulator: Simulator) -> str:
    """The description of a system: the docstring of its class."""
    return inspect.getdoc(type(simulator)) or ""


def tables(simulator: Simulator) -> str:
    """The tables of a system's variables and constants, each with a heading."""
    title = markdown(simulator.title)
    groups = {
        f"State of the {title}": simulator.state,
        f"Action of the {title}": simulator.action,
        f"Unobserved variables of the {title}": simulator.unobserved,
        f"Goal of the {title}": simulator.goal,
        f"Scenario variables of the {title}": simulator.scenario_variables,
        f"Scenario conditions of the {title}": simulator.scenario_conditions,
        f"Policy parameters of the {title}": simulator.policy_variables,
    }
    constants = (
        Constant("control steps of the horizon", simulator.default_horizon, "1"),
        Constant("control step", simulator.control_step, "s"),
        Constant("goal radius", simulator.radius, "m"),
        *simulator.constants(),
    )
    parts = [
        f"### {heading}\n\n{variables_table(variables)}"
        for heading, variables in groups.items()
        if variables
    ]
    return "\n\n".join([*parts, f"### Constants of the {title}\n\n{constants_table(constants)}"])


def _plot(simulator: Simulator, scenarios: ScenarioSet, folder: Path) -> list[Path]:
    success = simulator.outcome(scenarios.observed, scenarios.goal[:, None])
    chosen = typical(success)
    scenario = chosen[len(chosen) // 2]
    rollout = int(success[scenario].argmax())  # The first that succeeds, if any does.
    states = np.concatenate([scenarios.s0[scenario][None], scenarios.observed[scenario, rollout]])
    paths = {kind: folder / picture for kind, picture in _picture_names(simulator).items()}
    if "filmstrip" in paths:
        plot_filmstrip(simulator, states, scenarios.goal[scenario], paths["filmstrip"])
    plot_fans(simulator, scenarios, paths["fans"], chosen, simulator.plotted or None)
    plot_histogram(success, paths["histogram"])
    return list(paths.values())


def _picture_names(simulator: Simulator) -> dict[str, str]:
    """Paths of the pictures, by kind; a system without a scene has no filmstrip."""
    kinds = (
        ["fans", "histogram"] if simulator.scene() is None else ["filmstrip", "fans", "histogram"]
    )
    return {kind: f"pictures/{simulator.name}_{kind}.png" for kind in kinds}


def _section(simulator: Simulator, measured: Facts, seed: int) -> str:
    pictures = _picture_names(simulator)
    filmstrip = pictures.pop("filmstrip", None)
    return SECTION.format(
        title=markdown(simulator.title),
        filmstrip=FILMSTRIP.format(title=markdown(simulator.title), filmstrip=filmstrip)
        if filmstrip
        else "",
        id=gymnasium_id(type(simulator)),
        description=describe(simulator),
        probabilities="{}, {} and {}".format(*PROBABILITIES),
        seed=seed,
        facts="\n".join(f"| {quantity} | {value} |" for quantity, value in rows(measured)),
        symmetries=symmetries(simulator),
        tables=tables(simulator),
        **pictures,
    )
