"""Which scenarios are examples, and what is computed of them."""

import numpy as np
import pandas as pd

from study.data.storage import Arrays
from study.recording.examples import build_example, choose_examples, position_variance
from study.recording.illustration import illustrate
from tests.helpers import recordings


def _scores(mmd2: list[float], forecast: list[float], observed: list[float]) -> pd.DataFrame:
    rows = [
        (metric, "all", -1, scenario, value)
        for metric, values in (
            ("mmd2", mmd2),
            ("forecast_probability", forecast),
            ("observed_probability", observed),
        )
        for scenario, value in enumerate(values)
    ]
    return pd.DataFrame(rows, columns=["metric", "dimension", "step", "scenario", "value"])


def test_each_rule_chooses_its_scenario() -> None:
    scores = _scores(
        mmd2=[0.3, 0.1, 0.2, np.nan, 0.4, 0.5, 0.35, 0.6],
        forecast=[0.1, 0.0, 0.9, 0.0, 0.0, 0.0, 0.5, 0.0],
        observed=[0.9, 0.0, 0.0, 0.0, 0.0, 0.0, 0.45, 0.0],
    )
    expected = {
        "median MMD²": 4,
        "lowest MMD²": 1,
        "highest MMD²": 3,  # not finite is the worst
        "most uncertain outcome": 6,
        "success most overestimated": 2,
        "success most underestimated": 0,
        "90 % quantile of MMD²": 7,
        "scenario 5": 5,  # the 10 % quantile has the lowest MMD² already
    }
    assert choose_examples(scores, 8) == expected
    assert list(choose_examples(scores, 2)) == list(expected)[:2]


def _arrays(count: int = 2) -> Arrays:
    """The arrays of some examples, as the stage evaluate collects them."""
    examples = recordings.examples(recordings.Puck(), count)
    names = ("s0", "actions", "goal", "observed", "forecast", "member", "members")
    stacked = {name: np.stack([getattr(e, name) for e in examples]) for name in names}
    return stacked | {"scenario": np.arange(count)}


def test_the_parts_of_the_variance_add_up() -> None:
    simulator = recordings.Puck()
    example = build_example(_arrays(), 1, simulator, "title", "A description.")
    assert example.aleatoric is not None
    assert example.epistemic is not None
    position = simulator.position(example.forecast).astype(float)
    total = position.var(axis=0, ddof=1).sum(axis=-1)
    np.testing.assert_allclose(example.aleatoric + example.epistemic, total, rtol=1e-5, atol=1e-12)


def test_without_an_ensemble_no_variance_is_epistemic() -> None:
    states = recordings.examples(recordings.Puck(), 1)[0].forecast
    parts = position_variance(recordings.Puck(), states)
    np.testing.assert_array_equal(parts.epistemic, 0)
    np.testing.assert_array_equal(parts.aleatoric, parts.total)


def test_the_illustration_is_of_the_most_uncertain_outcome() -> None:
    simulator, arrays = recordings.Puck(), _arrays(3)
    chosen, facts = illustrate(simulator, arrays, ["one", "most uncertain outcome", "other"])
    assert facts["scenario"] == 1
    assert facts["samples"] == 40
    paths = simulator.position(arrays["observed"][1])
    np.testing.assert_array_equal(chosen["observed"][:, 1:], paths)
    start = simulator.position(arrays["s0"][1])
    np.testing.assert_array_equal(chosen["observed"][:, 0], np.tile(start, (40, 1)))
    assert illustrate(simulator, arrays, ["one", "two", "three"])[1]["scenario"] == 0
