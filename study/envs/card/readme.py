"""A page that says what some environments are: their docstrings, pictures, and measured facts."""

import inspect
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from study.common.files import write_text
from study.common.progress import Progress
from study.common.seeds import derive
from study.config.settings import Collect
from study.data.trajectories import ScenarioSet, joined
from study.envs import Simulator, gymnasium_id, simulators
from study.envs.card import facts
from study.envs.card.fans import fans, typical
from study.envs.card.filmstrip import filmstrip
from study.envs.card.histogram import histogram
from study.envs.observe import observe_scenarios

INTRODUCTION = """\
# The environments

Two systems in which uncertainty can be studied: their physics is in MuJoCo, everything random in
them comes from a seed, and the true distribution of what will happen is known, since a scenario can
be rolled out as often as one likes. They stand on their own; nothing here knows of a forecast.

```python
import gymnasium, study.envs

env = gymnasium.make("{id}", render_mode="rgb_array")   # one trajectory, step by step
observation, info = env.reset(seed=0)

simulator = study.envs.simulators["{name}"](threads=2)            # many at once, the same numbers
seeds = study.common.seeds.spawn(0, 1000)
scenarios = simulator.sample_scenarios(seeds)
actions = simulator.plan(scenarios, seeds)
rollout = simulator.rollout(scenarios.s0, actions, seeds)          # states [N, T+1, D]
```

A scenario is a start and a goal. A plan is what a policy does in it on the noise-free system; it is
then executed open loop in the noisy one, again and again: those are the rollouts. A scenario and a
rollout depend on their own seed alone, not on the batch around them, its order, or the number of
threads. The tests in `tests/envs/` hold the physics to conservation laws, formulas and independent
implementations, the Gymnasium environment to the batched one, and every number in the tables below
to the code. `tests/benchmarks/` says how fast it is.

`python -m study.run portrait --config configs/paper.yaml` wrote this page. It does the same for an
environment of your own: `python -m study.run portrait mine --plugins '[my_module]'`.
"""

SHOWN = """
![{title}: a filmstrip]({film})

One rollout of one scenario: the target, the way so far, and green from success on.

![{title}: fans of rollouts]({fans})

All rollouts of three scenarios, whose probabilities of success are near 0.1, 0.5 and 0.9.

![{title}: histogram of the probability of success]({histogram})

Measured on the test scenarios ({scenarios} of them, {rollouts} rollouts each, data seed {seed}):

| | |
|---|---|
{facts}
"""


def write(collect: Collect, names: Sequence[str], folder: Path, progress: Progress) -> list[Path]:
    """Write ``README.md`` and its pictures into `folder`.

    The scenarios are those of the study's test set.

    Args:
        collect: how many scenarios and rollouts, and the seed.
        names: of environments.
        folder: made if it is not there.
        progress: told how far it is.

    Raises:
        StudyError: there is no OpenGL to draw with.
    """
    first = simulators[names[0]]
    text = [INTRODUCTION.format(id=gymnasium_id(first), name=first.name)]
    written = []
    for number, name in enumerate(names):
        part = progress.part(number / len(names), (number + 1) / len(names))
        simulator = simulators[name](horizon=collect.horizon)
        seed = derive(derive(name, collect.seed), "test")
        scenarios = observe_scenarios(
            simulator, collect.scenarios, collect.rollouts, seed, part.part(0.0, 0.8)
        )
        observed = joined(scenarios)
        part(0.8, f"{name}: pictures")
        written += _pictures(simulator, observed, folder)
        text.append(_section(simulator, facts.facts(simulator, observed), collect.seed))
        part(1.0, name)
    write_text(folder / "README.md", "\n".join(text))
    return [folder / "README.md", *written]


def _pictures(simulator: Simulator, observed: ScenarioSet, folder: Path) -> list[Path]:
    success = simulator.outcome(observed.observed, observed.goal[:, None])
    shown = typical(success)
    scenario = shown[len(shown) // 2]
    rollout = int(success[scenario].argmax())  # one that succeeds, if any does
    states = np.concatenate([observed.s0[scenario][None], observed.observed[scenario, rollout]])
    film, fan, bars = (folder / picture for picture in _names(simulator))
    return [
        filmstrip(simulator, states, observed.goal[scenario], film),
        fans(simulator, observed, fan, shown, simulator.plotted or None),
        histogram(success, bars),
    ]


def _names(simulator: Simulator) -> tuple[str, str, str]:
    kinds = ("filmstrip", "fans", "histogram")
    film, fan, bars = (f"pictures/{simulator.name}_{kind}.png" for kind in kinds)
    return film, fan, bars


def _section(simulator: Simulator, measured: facts.Facts, seed: int) -> str:
    film, fan, bars = _names(simulator)
    shown = SHOWN.format(
        title=simulator.title,
        film=film,
        fans=fan,
        histogram=bars,
        scenarios=measured.scenarios,
        rollouts=measured.rollouts,
        seed=seed,
        facts="\n".join(f"| {what} | {number} |" for what, number in facts.rows(measured)),
    )
    title = f"## {simulator.title}: `{gymnasium_id(type(simulator))}`"
    return f"{title}\n{shown}\n{inspect.getdoc(type(simulator))}\n"
