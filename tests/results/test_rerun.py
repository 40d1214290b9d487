"""How far apart the scores of two evaluations may be."""

import numpy as np
import pandas as pd

from study.results.rerun import compare


def table(values: list[float]) -> pd.DataFrame:
    """A score over all scenarios, then scores of single scenarios."""
    scenario = np.arange(len(values)) - 1
    return pd.DataFrame(
        {"metric": "brier", "dimension": "all", "step": -1, "scenario": scenario, "value": values}
    )


def test_how_far_apart_scores_may_be() -> None:
    values = [0.25, *([0.5] * 199)]
    stored = table(values)
    assert compare("cell", stored, table(values))[0]
    assert "largest difference 0.0009" in compare("", stored, table([0.2509, *values[1:]]))[1]
    assert compare("", stored, table([0.2509, *values[1:]]))[0]
    assert not compare("", stored, table([0.2512, *values[1:]]))[0]
    assert compare("", stored, table([0.25, 0.7, *values[2:]]))[0]
    assert not compare("", stored, table([0.25, 0.7, 0.7, 0.7, *values[4:]]))[0]
    assert not compare("", stored, table([np.nan, *values[1:]]))[0]
    assert not compare("", stored, table(values[:-1]))[0]
    lost = table([np.inf, np.nan, *values[2:]])
    assert compare("", lost, lost.copy())[0]
