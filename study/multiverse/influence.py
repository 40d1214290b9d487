"""Which choice moves an effect most: a linear regression of the effect on the choices.

The effect in universe u is modelled as a constant plus one term for each value that differs from
the first value of its choice (treatment coding), without interactions. A term is the mean change of
the effect when the choice takes that value and all others stay. Intervals are t intervals with the
HC3 covariance (MacKinnon and White 1985; Long and Ervin 2000), which allows the scatter around the
model to differ between universes. The scatter has two sources: interactions of choices, and the
variation of training.

A model that diverges in a few universes has effects there that are many times those elsewhere, and
these few would decide a regression of the effect. So the ranks of the effects are regressed too
(the rank transformation of Conover and Iman 1981), and the shares are those of ranks.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy import stats

from study.common.arrays import Doubles
from study.metrics.intervals import PROBABILITY
from study.multiverse.design import Choice, Values
from study.multiverse.one_way import SIGNIFICANCE, TINY

FULL_LEVERAGE = 1 - 1e-9
"""Leverage of a universe that alone determines a term. Its scatter is unknown."""


@dataclass(frozen=True)
class Change:
    """A mean change with its 95 % interval, which is infinite where it is undefined."""

    mean: float
    low: float
    high: float


@dataclass(frozen=True)
class Term:
    """The mean change by one value of a choice, relative to its first value.

    Attributes:
        choice: name of the choice.
        value: the value.
        effect: the change of the effect.
        rank: the change of the rank of the effect, as a share of all universes.
        universes: number of universes with the value.
    """

    choice: str
    value: str
    effect: Change
    rank: Change
    universes: int


@dataclass(frozen=True, eq=False)
class Influence:
    """The regression of one effect on the choices.

    Attributes:
        effects: the effects that are regressed, by the name of the universe.
        terms: in the order of the choices.
        shares: share of the variance of the ranks that is lost if a choice is left out of the
            regression, by choice: the semipartial R², corrected for what a choice without effect
            explains by chance (ε² of Kelley 1935), and at least 0.
        p_values: of the F test of a choice on the ranks, by choice.
        explained: share of that variance that all choices explain (adjusted R²).
    """

    effects: "pd.Series[float]"
    terms: tuple[Term, ...]
    shares: Mapping[str, float]
    p_values: Mapping[str, float]
    explained: float

    @property
    def strongest(self) -> str | None:
        """The choice with the largest share, if it is significant."""
        best = max(self.shares, key=self.shares.__getitem__, default=None)
        return best if best is not None and self.is_significant(best) else None

    def is_significant(self, choice: str) -> bool:
        """Whether a choice has a share that is not due to chance, by its F test.

        The level is `SIGNIFICANCE`, divided by the number of choices (Bonferroni).
        """
        return self.p_values[choice] < SIGNIFICANCE / len(self.shares)


def influence(
    effects: "pd.Series[float]", values: Mapping[str, Values], choices: Sequence[Choice]
) -> Influence | None:
    """Regress an effect on the choices.

    Args:
        effects: the effect by the name of the universe. Effects that are not finite are left out.
        values: the values of each universe.
        choices: of the design. Those that do not vary between the universes are left out.

    Returns:
        None if there are too few universes to tell the choices apart, or less than twice as many
        as terms, since such a regression explains much by chance.
    """
    finite = effects[np.isfinite(effects)]
    readings = [values[str(name)] for name in finite.index]
    columns = _columns(readings, choices)
    design = np.column_stack([np.ones(len(finite)), *columns.values()])
    count, terms = design.shape
    if count < 2 * terms or np.linalg.matrix_rank(design) < terms:
        return None
    outcome: Doubles = np.asarray(finite.to_numpy(), np.float64)
    ranks: Doubles = np.asarray(finite.rank().to_numpy(), np.float64) / count
    total = float(((ranks - ranks.mean()) ** 2).sum())
    whole = _residual(design, ranks)
    error = whole / (count - terms)

    shares, p_values = {}, {}
    for choice in dict.fromkeys(choice for choice, _ in columns):
        others = [column for (name, _), column in columns.items() if name != choice]
        gain = _residual(np.column_stack([np.ones(count), *others]), ranks) - whole
        freedom = len(columns) - len(others)
        shares[choice] = max(gain - freedom * error, 0.0) / total if total > TINY else 0.0
        ratio = gain / freedom / max(error, TINY)
        p_values[choice] = float(stats.f.sf(ratio, freedom, count - terms))
    of_effect, of_rank = _changes(design, outcome), _changes(design, ranks)
    found = [
        Term(choice, value, effect, rank, int(column.sum()))
        for ((choice, value), column), effect, rank in zip(
            columns.items(), of_effect, of_rank, strict=True
        )
    ]
    explained = max(1 - error * (count - 1) / total, 0.0) if total > TINY else 0.0
    return Influence(finite, tuple(found), shares, p_values, explained)


def _changes(design: Doubles, outcome: Doubles) -> list[Change]:
    """The change of an outcome by each term but the constant."""
    mean, half = fit(design, outcome)
    return [
        Change(m, m - h, m + h) for m, h in zip(map(float, mean), map(float, half), strict=True)
    ][1:]


def fit(design: Doubles, outcome: Doubles) -> tuple[Doubles, Doubles]:
    """Least squares with HC3 intervals.

    Args:
        design: [n, p] of full rank, with n > p.
        outcome: [n].

    Returns:
        coefficients [p], and half the widths of their intervals [p].
    """
    count, terms = design.shape
    inverse = np.linalg.pinv(design)
    coefficients = inverse @ outcome
    leverage = np.einsum("ij,ji->i", design, inverse)
    alone = leverage > FULL_LEVERAGE
    scatter = (outcome - design @ coefficients) / np.where(alone, 1.0, 1 - leverage)
    variance = (inverse**2 @ np.where(alone, 0.0, scatter) ** 2).astype(np.float64)
    unknown = (np.abs(inverse[:, alone]) > 1e-9).any(axis=1)
    quantile = stats.t.ppf((1 + PROBABILITY) / 2, count - terms)
    return coefficients, np.where(unknown, np.inf, quantile * np.sqrt(variance))


def _columns(
    readings: Sequence[Values], choices: Sequence[Choice]
) -> dict[tuple[str, str], Doubles]:
    """An indicator [n] for each value of a choice that occurs, but for the first that does."""
    columns = {}
    for choice in choices:
        chosen = np.array([reading[choice.name] for reading in readings], dtype=object)
        present = [value for value in choice.values if (chosen == value).any()]
        for value in present[1:]:
            columns[choice.name, value] = (chosen == value).astype(np.float64)
    return columns


def _residual(design: Doubles, outcome: Doubles) -> float:
    """The sum of squared residuals of least squares."""
    coefficients, *_ = np.linalg.lstsq(design, outcome, rcond=None)
    return float(((outcome - design @ coefficients) ** 2).sum())
