"""What one choice explains of an effect without the others: an analysis of variance of ranks.

The effects are replaced by their ranks, as in `study.multiverse.influence`, so a universe in which
a model diverges counts like any other.

Over all universes, choices that differ together between the base readings occur together, so each
of them explains what the others explain too. Over the universes with random values, values are
assigned independently, except for the excluded combinations. But with few universes some choices
are correlated by chance, so a part of a share can be due to another choice.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy import stats

from study.common.arrays import Doubles
from study.multiverse.design import Choice, Values

SIGNIFICANCE = 0.05
TINY = 1e-12
"""Sums of squares and mean squared errors of ranks below it are rounding errors."""


@dataclass(frozen=True)
class OneWay:
    """The analysis of one choice.

    Attributes:
        share: share of the variance of the ranks between the values of the choice, corrected for
            what a choice without effect explains by chance, and at least 0: ε² of Kelley (1935),
            which is the adjusted R².
        p_value: of the F test.
        ranks: the mean rank with a value minus that with the first value of the choice, as a share
            of all universes, by value. It is empty if no universe has the first value.
        level: of significance: `SIGNIFICANCE`, divided by the number of choices (Bonferroni).
    """

    share: float
    p_value: float
    ranks: Mapping[str, float]
    level: float

    @property
    def is_significant(self) -> bool:
        """Whether the share is not due to chance, by the F test."""
        return self.p_value < self.level


def one_way(
    effects: "pd.Series[float]", values: Mapping[str, Values], choices: Sequence[Choice]
) -> dict[str, OneWay]:
    """Analyse an effect by each choice, without the other choices.

    Args:
        effects: the effect by the name of the universe. Effects that are not finite are left out.
        values: the values of each universe.
        choices: of the design. Those that do not vary between the universes are left out, and so
            are those with a universe for each value, whose scatter is unknown.
    """
    finite = effects[np.isfinite(effects)]
    ranks: Doubles = np.asarray(finite.rank().to_numpy(), np.float64) / max(len(finite), 1)
    grouped = {}
    for choice in choices:
        chosen = np.array([values[str(name)][choice.name] for name in finite.index], dtype=object)
        groups = {value: ranks[chosen == value] for value in choice.values if value in chosen}
        if 1 < len(groups) < len(finite):
            grouped[choice.name] = choice.default, groups
    level = SIGNIFICANCE / max(len(grouped), 1)
    return {name: _analyse(groups, first, level) for name, (first, groups) in grouped.items()}


def _analyse(groups: Mapping[str, Doubles], first: str, level: float) -> OneWay:
    ranks = np.concatenate(list(groups.values()))
    means = {value: float(group.mean()) for value, group in groups.items()}
    total = float(((ranks - ranks.mean()) ** 2).sum())
    within = sum(float(((group - means[value]) ** 2).sum()) for value, group in groups.items())
    between, freedom = len(groups) - 1, len(ranks) - len(groups)
    error = within / freedom
    share = max(total - within - between * error, 0.0) / total if total > TINY else 0.0
    ratio = (total - within) / between / max(error, TINY)
    p_value = float(stats.f.sf(ratio, between, freedom))
    changes = {v: means[v] - means[first] for v in means if v != first} if first in means else {}
    return OneWay(share, p_value, changes, level)
