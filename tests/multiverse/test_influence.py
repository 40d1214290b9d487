"""The regression of effects on choices: its terms, shares and intervals."""

import numpy as np
import pandas as pd
import pytest
import scipy.stats
from sklearn.linear_model import LinearRegression

from study.claims.claim import Rule
from study.commands.settings import CONFIGS, read_part
from study.common.arrays import Doubles
from study.multiverse.choices import influence_on
from study.multiverse.effects import support
from study.multiverse.influence import Influence, fit, influence
from study.multiverse.read import PART, design_from
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
    choices = ["forecast", "target", "beta", "beta", "features"]
    assert [term.choice for term in found.terms] == choices


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


def test_effects_of_chance_have_no_strongest_choice() -> None:
    """Of the committed design: some share is the largest, but rarely significant."""
    planned = design_from(read_part(str(CONFIGS / "multiverse.yaml"), PART))
    values = {universe.name: universe.values for universe in universes(planned)}
    generator = np.random.default_rng(4)
    found: list[str | None] = []
    shares: list[float] = []
    for _ in range(60):
        effects = pd.Series(generator.standard_t(2, len(values)), index=list(values))
        regression = influence(effects, values, planned.choices)
        assert regression is not None
        found.append(regression.strongest)
        shares += regression.shares.values()
    assert found.count(None) >= 51  # the level is 5 %
    assert np.mean(shares) < 0.02


def test_a_share_is_the_part_of_the_variance_that_is_lost() -> None:
    """Two choices without correlation, and many universes: ε² is the true share."""
    planned = design(exclude=[])
    generator = np.random.default_rng(6)
    one, two = (c for c in planned.choices if c.name in ("forecast", "target"))
    values = {
        f"u{number}": {"forecast": forecast, "target": target}
        for number, (forecast, target) in enumerate(
            [(a, b) for a in one.values for b in two.values] * 500
        )
    }
    scatter = generator.normal(size=len(values))
    effects = pd.Series(
        [
            (v["forecast"] == "mean") + 0.5 * (v["target"] == "state") + 0.5 * noise
            for v, noise in zip(values.values(), scatter, strict=True)
        ],
        index=list(values),
    )
    found = influence(effects, values, [one, two])
    assert found is not None
    # Variances of the effects: 1/4, 1/16 and 1/4. Those of ranks differ a little.
    assert found.shares["forecast"] == pytest.approx(4 / 9, abs=0.05)
    assert found.shares["target"] == pytest.approx(1 / 9, abs=0.05)
    assert found.explained == pytest.approx(5 / 9, abs=0.05)
    assert found.is_significant("forecast")
    assert found.is_significant("target")


def test_the_p_values_are_those_of_the_f_test() -> None:
    """Of one choice with two values: that of the t test of two groups of ranks."""
    planned = design(random=24)
    values = {universe.name: universe.values for universe in universes(planned)}
    (choice,) = [c for c in planned.choices if c.name == "target"]
    generator = np.random.default_rng(8)
    effects = pd.Series(generator.normal(size=len(values)), index=list(values))
    found = influence(effects, values, [choice])
    assert found is not None
    with_state = np.array([v["target"] == "state" for v in values.values()])
    ranks = effects.rank().to_numpy()
    expected = scipy.stats.ttest_ind(ranks[with_state], ranks[~with_state]).pvalue
    assert found.p_values["target"] == pytest.approx(expected)


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


def test_the_support_for_a_claim_of_equivalence_is_the_distance_to_its_margin() -> None:
    rows = pd.DataFrame(
        {"universe": ["a", "b", "c"], "effect": [-0.03, 0.01, 0.03], "margin": [0.02, 0.02, 0.05]}
    )
    assert support(rows, Rule.EQUAL).to_dict() == pytest.approx({"a": -0.01, "b": 0.01, "c": 0.02})
    assert support(rows, Rule.ABOVE).to_dict() == {"a": -0.03, "b": 0.01, "c": 0.03}


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
    assert len(found.effects) == len(values) - 1


def test_a_choice_that_does_not_vary_is_left_out() -> None:
    planned = design(random=48, exclude=[])
    every = [u for u in universes(planned) if u.values["target"] == "change"]
    values = {universe.name: universe.values for universe in every}
    effects = pd.Series(np.arange(len(values), dtype=float), index=list(values))
    found = influence(effects, values, planned.choices)
    assert found is not None
    assert "target" not in found.shares
