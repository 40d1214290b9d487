"""The examples of a cell: scenarios that recordings and figures show, chosen by rules."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from study.common.arrays import Doubles, Floats, Integers
from study.data.storage import Arrays, load_arrays
from study.envs.simulator import Simulator
from study.metrics.variance import Decomposition, decompose

MOST_UNCERTAIN = "most uncertain outcome"
"""The rule that chooses the scenario whose observed probability of success is closest to 1/2.

If all outcomes were observed once, the forecast probability counts."""


@dataclass(frozen=True)
class Example:
    """One scenario with its observed and forecast trajectories, in SI units.

    Attributes:
        title: a few words.
        description: a sentence about the origin of the example.
        s0: [D].
        actions: [T, A].
        goal: [G].
        observed: [K, T, D], the observed states s_1 … s_T.
        forecast: [K, T, D], the forecast states.
        member: [K] integers, the ensemble member of each forecast; None without an ensemble. In an
            ensemble of residual models, `member` mod M is the recurrent network.
        members: [M, T, D], the forecast of each member without noise; None without an ensemble.
        aleatoric: [T], aleatoric variance of the forecast position in m², summed over its axes;
            None without an ensemble.
        epistemic: [T], epistemic variance of the forecast position in m², summed over its axes;
            None without an ensemble.
    """

    title: str
    description: str
    s0: Floats
    actions: Floats
    goal: Floats
    observed: Floats
    forecast: Floats
    member: Integers | None = None
    members: Floats | None = None
    aleatoric: Doubles | None = None
    epistemic: Doubles | None = None


def choose_examples(scores: pd.DataFrame, count: int) -> dict[str, int]:
    """Select up to `count` different scenarios by rules.

    Args:
        scores: the tidy scores of one cell; see `study.metrics.tables.table`.
        count: the number of examples; fewer if the test set has fewer scenarios.

    Returns:
        the scenario by the name of its rule. If two rules select the same scenario, the first rule
        counts.
    """
    mmd2 = np.nan_to_num(_by_scenario(scores, "mmd2"), nan=np.inf)
    forecast = _by_scenario(scores, "forecast_probability")
    observed = _by_scenario(scores, "observed_probability")
    order = np.argsort(mmd2, kind="stable")
    rules = {
        "median MMD²": order[len(order) // 2],
        "lowest MMD²": order[0],
        "highest MMD²": order[-1],
    }
    if len(observed):  # a recorded system may have no outcome
        # The outcome of one rollout is certain.
        uncertain = forecast if np.isin(observed, (0, 1)).all() else observed
        rules |= {
            MOST_UNCERTAIN: np.argmin(np.abs(uncertain - 0.5)),
            "success most overestimated": np.argmax(forecast - observed),
            "success most underestimated": np.argmax(observed - forecast),
        }
    rules |= {
        "90 % quantile of MMD²": order[int(0.9 * (len(order) - 1))],
        "10 % quantile of MMD²": order[int(0.1 * (len(order) - 1))],
    }
    rules |= {f"scenario {index}": index for index in range(len(order))}
    examples: dict[str, int] = {}
    for rule, index in rules.items():
        if len(examples) < count and int(index) not in examples.values():
            examples[rule] = int(index)
    return examples


def _by_scenario(scores: pd.DataFrame, metric: str) -> Doubles:
    """One metric of each scenario [S], averaged over dimensions and steps."""
    rows = scores[(scores.metric == metric) & (scores.scenario >= 0) & (scores.step == -1)]
    rows = rows[rows.dimension == "all"]
    return np.asarray(rows.sort_values("scenario").value)


def read_examples(path: Path, scores: pd.DataFrame, simulator: Simulator) -> list[Example]:
    """Read the examples of the stage evaluate.

    Args:
        path: ``examples.safetensors``.
        scores: the tidy scores of the same cell.
        simulator: the real system.

    Raises:
        StudyError: the file is missing or damaged.
    """
    arrays, facts = load_arrays(path)
    mmd2 = _by_scenario(scores, "mmd2")
    return [
        build_example(
            arrays,
            row,
            simulator,
            rule,
            f"Scenario {scenario} of the test set, chosen by this rule: *{rule}*. "
            f"Its MMD² is {mmd2[scenario]:.4f}.",
        )
        for row, (scenario, rule) in enumerate(zip(arrays["scenario"], facts["rules"], strict=True))
    ]


def build_example(
    arrays: Arrays, row: int, simulator: Simulator, title: str, description: str
) -> Example:
    """The example in one row of the arrays of `study.models.forecasting.example_arrays`.

    With an ensemble, the variance of the position is split into its two parts.
    """
    names = ("s0", "actions", "goal", "observed", "forecast", "member", "members")
    values = {name: arrays[name][row] for name in names if name in arrays}
    if "member" in values and simulator.has_position:
        parts = position_variance(simulator, values["forecast"], values["member"])
        values |= {"aleatoric": parts.aleatoric, "epistemic": parts.epistemic}
    return Example(title=title, description=description, **values)


def position_variance(
    simulator: Simulator, states: Floats, member: Integers | None = None
) -> Decomposition:
    """Variance of the position in m², summed over its axes, and its parts, over the horizon [T].

    The parts are unbiased: the sampling error of the members' means is subtracted from the
    epistemic part. See `study.metrics.variance.decompose`.

    Args:
        simulator: computes the position.
        states: [K, T, D] in SI units.
        member: [K], the ensemble member of each sample; None without an ensemble.
    """
    parts = decompose(simulator.position(states)[None], None if member is None else member[None])
    return Decomposition(*(part.sum(axis=-1) for part in vars(parts).values()))
