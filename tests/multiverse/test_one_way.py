"""What a choice explains without the others: shares, tests, and the readings with random values."""

from itertools import combinations

import numpy as np
import pandas as pd
import pytest
from scipy import stats
from sklearn.linear_model import LinearRegression

from study.commands.settings import CONFIGS, read_part
from study.multiverse.choices import each_alone
from study.multiverse.design import RANDOM, Design, Values
from study.multiverse.effects import curve
from study.multiverse.one_way import one_way
from study.multiverse.read import PART, design_from
from study.multiverse.universes import universes
from tests.helpers.multiverse import design, multiverse


def committed() -> Design:
    return design_from(read_part(str(CONFIGS / "multiverse.yaml"), PART))


def values_of(planned: Design) -> dict[str, Values]:
    return {universe.name: universe.values for universe in universes(planned)}


def noise(values: dict[str, Values], seed: int) -> "pd.Series[float]":
    return pd.Series(np.random.default_rng(seed).normal(size=len(values)), index=list(values))


def test_the_share_is_an_adjusted_r2() -> None:
    """By another library: of a linear regression of the ranks on indicators of the values."""
    planned = design(random=48)
    values = values_of(planned)
    effects = noise(values, 1) + [3.0 * (v["beta"] == "one") for v in values.values()]
    ranks = effects.rank()
    found = one_way(effects, values, planned.choices)
    for choice in planned.choices:
        chosen = pd.Series({name: v[choice.name] for name, v in values.items()})
        columns = pd.get_dummies(chosen[ranks.index]).to_numpy(np.float64)[:, 1:]
        r2 = LinearRegression().fit(columns, ranks).score(columns, ranks)
        count, terms = columns.shape
        expected = 1 - (1 - r2) * (count - 1) / (count - terms - 1)
        assert found[choice.name].share == pytest.approx(max(expected, 0.0))
    assert max(found, key=lambda name: found[name].share) == "beta"


def test_the_p_values_and_changes_of_ranks() -> None:
    """The F test of SciPy, and the differences of mean ranks."""
    planned = design(random=48)
    values = values_of(planned)
    effects = noise(values, 2)
    found = one_way(effects, values, planned.choices)
    for choice in planned.choices:
        chosen = pd.Series({name: v[choice.name] for name, v in values.items()})
        groups = {value: effects.rank()[chosen == value] for value in choice.values}
        expected = stats.f_oneway(*groups.values()).pvalue
        assert found[choice.name].p_value == pytest.approx(expected)
        first, *others = groups
        assert set(found[choice.name].ranks) == set(others)
        for value in others:
            change = (groups[value].mean() - groups[first].mean()) / len(effects)
            assert found[choice.name].ranks[value] == pytest.approx(change)


@pytest.mark.parametrize("choice", [choice.name for choice in committed().choices])
def test_random_values_tell_choices_apart(choice: str) -> None:
    """A choice that decides has by far the largest share, among the 24 random universes."""
    planned = committed()
    values = {u.name: u.values for u in universes(planned) if u.group == RANDOM}
    default = next(c.default for c in planned.choices if c.name == choice)
    decided = [2.0 * (v[choice] == default) for v in values.values()]
    found = one_way(0.3 * noise(values, 3) + decided, values, planned.choices)
    first, second, *_ = sorted(found, key=lambda name: found[name].share, reverse=True)
    assert first == choice
    assert found[first].is_significant
    assert found[second].share < found[first].share / 2


def test_choices_that_differ_together_share_an_effect_over_all_universes() -> None:
    """Eight choices differ together between the base readings of the committed design."""
    planned = committed()
    values = values_of(planned)
    effects = 0.2 * noise(values, 3) + [float(v["features"] == "none") for v in values.values()]
    alone = one_way(effects, values, planned.choices)
    assert sum(one.is_significant for one in alone.values()) >= 4


def test_the_correlation_of_random_values() -> None:
    """That of the committed design, which `study/multiverse/README.md` states."""
    planned = committed()
    values = [u.values for u in universes(planned) if u.group == RANDOM]
    columns = pd.DataFrame(values)
    found = [
        stats.contingency.association(pd.crosstab(columns[one], columns[other]), "cramer")
        for one, other in combinations(columns, 2)
    ]
    assert round(max(found), 2) == 0.54


def test_the_universes_of_a_group() -> None:
    results = multiverse(random=24)
    claim = results.effects["claim"].iloc[0]
    effects = curve(results.effects, claim).set_index("universe")["effect"]
    names = [u.name for u in results.universes if u.group == RANDOM]
    chosen = effects[effects.index.isin(names)]
    assert 0 < len(chosen) < len(effects)
    expected = one_way(chosen, results.values, results.design.choices)
    assert each_alone(results, claim, group=RANDOM) == expected
    assert each_alone(results, claim) == one_way(effects, results.values, results.design.choices)


def test_effects_of_chance_have_few_significant_choices() -> None:
    """Of the random values of the committed design: the level of all choices together is 5 %."""
    planned = committed()
    values = {u.name: u.values for u in universes(planned) if u.group == RANDOM}
    generator = np.random.default_rng(4)
    found = []
    for _ in range(200):
        effects = pd.Series(generator.standard_t(2, len(values)), index=list(values))
        every = one_way(effects, values, planned.choices)
        found.append(any(one.is_significant for one in every.values()))
    assert len(every) == len(planned.choices)
    assert np.mean(found) < 0.09


def test_the_smallest_share_that_is_significant() -> None:
    """In the committed design a choice of two values needs about 30 % of the variance of ranks."""
    planned = committed()
    count, choices = planned.random, len(planned.choices)
    ratio = stats.f.isf(0.05 / choices, 1, count - 2)
    share = (ratio - 1) / (ratio + count - 2)
    assert share == pytest.approx(0.3, abs=0.02)
    values = {u.name: u.values for u in universes(planned) if u.group == RANDOM}
    first = np.array([v["target"] == "delta" for v in values.values()])
    found = [
        one_way(noise(values, 5) + size * first, values, planned.choices)["target"]
        for size in np.linspace(0, 3, 13)
    ]
    assert [one.is_significant for one in found] == [one.share > share for one in found]
    assert {one.is_significant for one in found} == {False, True}


def test_without_the_first_value_there_are_no_changes_of_ranks() -> None:
    planned = design(random=48, exclude=[])
    values = {name: v for name, v in values_of(planned).items() if v["beta"] != "high"}
    found = one_way(noise(values, 7), values, planned.choices)
    assert found["beta"].ranks == {}
    assert set(found["target"].ranks) == {"state"}


def test_a_choice_that_decides_and_one_that_does_not() -> None:
    planned = design(random=24)
    values = values_of(planned)
    effects = pd.Series({name: float(v["target"] == "state") for name, v in values.items()})
    found = one_way(effects, values, planned.choices)
    assert found["target"].share == pytest.approx(1.0)
    assert found["target"].is_significant
    assert found["target"].ranks["state"] == pytest.approx(0.5)
    equal = one_way(0 * effects, values, planned.choices)
    assert {one.share for one in equal.values()} == {0.0}
    assert min(one.p_value for one in equal.values()) > 0.99


def test_effects_that_are_not_finite_and_choices_that_do_not_vary_are_left_out() -> None:
    planned = design(random=24)
    values = values_of(planned)
    effects = noise(values, 6)
    effects[[v["target"] == "state" for v in values.values()]] = np.inf
    found = one_way(effects, values, planned.choices)
    assert "target" not in found
    expected = one_way(effects[np.isfinite(effects)], values, planned.choices)
    assert found == expected
    assert {one.level for one in found.values()} == {0.05 / (len(planned.choices) - 1)}
    assert one_way(effects[:0], values, planned.choices) == {}
    assert one_way(effects[:2], values, planned.choices) == {}
