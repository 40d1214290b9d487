"""The regression of effects on choices: its terms, shares and intervals."""

import numpy as np
import pandas as pd
import pytest
from sklearn.linear_model import LinearRegression

from study.common.arrays import Doubles
from study.multiverse.influence import Influence, fit, influence
from study.multiverse.report import influence_on
from study.multiverse.universes import universes
from tests.helpers.multiverse import ADDED, SCATTER, design, multiverse

BIG = {"random": 60, "exclude": []}


def regression() -> Influence:
    results = multiverse(**BIG)
    found = influence_on(results, results.effects["claim"].iloc[0])
    assert found is not None
    return found


def test_the_terms_are_what_the_values_add() -> None:
    found = regression()
    for term in found.terms:
        effect = term.effect
        assert effect.mean == pytest.approx(ADDED.get((term.choice, term.value), 0.0), abs=0.005)
        assert effect.low < effect.mean < effect.high < effect.mean + 6 * SCATTER
    assert [term.choice for term in found.terms] == ["forecast", "target", "beta", "beta"]


def test_the_shares_are_in_the_order_of_the_changes() -> None:
    found = regression()
    assert found.strongest == "forecast"
    assert found.shares["forecast"] > found.shares["beta"] > found.shares["target"] > 0
    assert sum(found.shares.values()) == pytest.approx(found.explained, abs=0.2)
    assert found.explained > 0.95


def test_a_universe_with_a_large_effect_does_not_decide() -> None:
    """A model that diverges adds much to one effect: not to its rank, nor to the shares."""
    results = multiverse(**BIG)
    claim = results.effects["claim"].iloc[0]
    rows = results.effects["claim"] == claim
    before = influence_on(results, claim)
    lowest = results.effects.loc[rows, "effect"].idxmin()
    results.effects.loc[lowest, "effect"] = -1000.0
    after = influence_on(results, claim)
    assert before is not None
    assert after is not None
    assert after.shares == before.shares
    assert [term.rank for term in after.terms] == [term.rank for term in before.terms]
    assert max(abs(term.effect.mean) for term in after.terms) > 10


def test_the_changes_of_ranks_are_shares_of_the_universes() -> None:
    """Two groups of which one is above the other differ by half of the universes."""
    planned = design(random=24)
    values = {universe.name: universe.values for universe in universes(planned)}
    (choice,) = [c for c in planned.choices if c.name == "target"]
    effects = pd.Series({name: float(v["target"] == "state") for name, v in values.items()})
    found = influence(effects, values, [choice])
    assert found is not None
    (term,) = found.terms
    assert term.effect.mean == pytest.approx(1.0)
    assert term.rank.mean == pytest.approx(0.5)
    assert found.explained == pytest.approx(1.0)
    assert found.shares == {"target": pytest.approx(1.0)}


def random_design(generator: np.random.Generator, count: int, terms: int) -> Doubles:
    indicators = generator.integers(0, 2, (count, terms)).astype(float)
    return np.column_stack([np.ones(count), indicators])


def test_the_same_coefficients_as_scikit_learn() -> None:
    generator = np.random.default_rng(1)
    table = random_design(generator, 30, 4)
    outcome = generator.normal(size=30)
    expected = LinearRegression().fit(table[:, 1:], outcome)
    coefficients, _ = fit(table, outcome)
    np.testing.assert_allclose(coefficients[1:], expected.coef_)
    assert coefficients[0] == pytest.approx(expected.intercept_)


def test_two_groups_have_the_interval_of_welch() -> None:
    # Of two groups, HC3 is n/(n-1)² Σ(x - mean)² for each: that of Welch times n/(n-1).
    generator = np.random.default_rng(2)
    first, second = generator.normal(size=8), generator.normal(3.0, 4.0, size=12)
    table = np.column_stack([np.ones(20), np.repeat([0.0, 1.0], [8, 12])])
    coefficients, half = fit(table, np.concatenate([first, second]))
    assert coefficients[1] == pytest.approx(second.mean() - first.mean())
    variance = first.var(ddof=1) / 7 + second.var(ddof=1) / 11
    assert half[1] == pytest.approx(2.1009 * np.sqrt(variance), rel=1e-4)  # t(18), 97.5 %


@pytest.mark.parametrize("spread", [(1.0, 1.0), (0.3, 3.0)])
def test_the_intervals_cover_the_true_change(spread: tuple[float, float]) -> None:
    """In a design of the size of the committed one, also where the scatter depends on a value."""
    generator = np.random.default_rng(3)
    true, inside = 0.7, []
    for _ in range(400):
        table = random_design(generator, 54, 14)
        scatter = np.where(table[:, 1] > 0, *spread)
        outcome = table @ np.array([1.0, true, *[0.2] * 13]) + scatter * generator.normal(size=54)
        coefficients, half = fit(table, outcome)
        inside.append(abs(coefficients[1] - true) <= half[1])
    assert 0.92 <= np.mean(inside) <= 0.99


def test_a_value_of_a_single_universe_has_no_interval() -> None:
    table = np.column_stack([np.ones(6), [0, 0, 0, 1, 1, 1], [0, 0, 0, 0, 0, 1]]).astype(float)
    coefficients, half = fit(table, np.array([0.0, 1.0, 2.0, 3.0, 5.0, 9.0]))
    assert np.isinf(half[2])
    assert np.isfinite(half[:2]).all()
    assert coefficients[2] == pytest.approx(5.0)


def test_too_few_universes_have_no_regression() -> None:
    planned = design(random=0)
    values = {universe.name: universe.values for universe in universes(planned)}
    effects = pd.Series(dict.fromkeys(list(values)[:3], 1.0))
    assert influence(effects, values, planned.choices) is None


def test_effects_that_are_not_finite_are_left_out() -> None:
    planned = design(random=24)
    values = {universe.name: universe.values for universe in universes(planned)}
    effects = pd.Series(np.arange(len(values), dtype=float), index=list(values))
    effects.iloc[2] = np.inf
    found = influence(effects, values, planned.choices)
    assert found is not None
    assert found.universes == len(values) - 1


def test_a_choice_that_does_not_vary_is_left_out() -> None:
    planned = design(random=24)
    every = [u for u in universes(planned) if u.values["target"] == "change"]
    values = {universe.name: universe.values for universe in every}
    effects = pd.Series(np.arange(len(values), dtype=float), index=list(values))
    found = influence(effects, values, planned.choices)
    assert found is not None
    assert "target" not in found.shares
