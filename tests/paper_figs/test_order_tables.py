"""The tables on the order of the models in the readings of the multiverse."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from paper_figs.pages import order_tables
from study.config.names import FULL, MLP, MODELS, RESIDUAL
from study.multiverse.folder import Multiverse
from tests.helpers.multiverse import multiverse
from tests.paper_figs.pipe_tables import pipe_cells

CLAIM = "mmd-residual-lowest-uav-high"
ROW = "MMD², UAV, high epistemic"


def readings(
    mmd2: Mapping[str, tuple[float, float, float]], status: Mapping[str, str] | None = None
) -> Multiverse:
    """Results on the UAV with little data.

    Args:
        mmd2: of the residual VAE, the full VAE and the MLP, by universe.
        status: of the contrast of the two VAEs, by universe.
    """
    results = multiverse(random=24)
    rows = [
        {"universe": name, "model": model, "mmd2": value, "brier": 1 - value}
        for name, values in mmd2.items()
        for model, value in zip((RESIDUAL, FULL, MLP), values, strict=True)
    ]
    cells = pd.DataFrame(rows).assign(environment="uav", level="high", seed=0)
    effects = pd.DataFrame(
        [
            {"universe": name, "claim": CLAIM, "contrast": "full VAE minus residual VAE"}
            | {"decisive": True, "effect": 0.1, "status": word}
            for name, word in (status or dict.fromkeys(mmd2, "holds")).items()
        ]
    )
    return replace(results, cells=cells, effects=effects)


def test_the_order_of_the_models_is_counted_by_the_readings_around_a_base() -> None:
    results = multiverse(random=24)
    claim = "mmd-residual-lowest-uav-high"
    effects = results.effects[results.effects["claim"] == results.effects["claim"].iloc[0]]
    effects = effects[effects["decisive"]].assign(
        claim=claim, contrast="full VAE minus residual VAE", status="undecided"
    )
    effects.loc[effects["universe"].isin(["study", "study/beta=one"]), "status"] = "holds"
    effects.loc[effects["universe"] == "study/beta=low", "status"] = "contradicted"
    table = pipe_cells(order_tables.orders(replace(results, effects=effects)))
    assert {row for row, _ in table} == {"MMD², UAV, high epistemic"}
    near = [name for name in results.scored if name.startswith("study")]
    assert table["MMD², UAV, high epistemic", f"than the full VAE: study ({len(near)})"] == "2 / 1"
    random = [name for name in results.scored if name.startswith("random")]
    column = f"than the full VAE: random values ({len(random)})"
    assert table["MMD², UAV, high epistemic", column] == "0 / 0"
    assert (
        table["MMD², UAV, high epistemic", f"than the probabilistic MLP: study ({len(near)})"]
        == "—"
    )


def test_the_order_of_the_paper_and_the_lowest_are_counted() -> None:
    """By group, and among the readings with finite scores of all three models."""
    results = readings(
        {
            "study": (0.1, 0.2, 0.3),
            "study/beta=one": (0.2, 0.1, 0.3),
            "study/beta=low": (0.2, 0.3, 0.1),
            "as_written": (0.1, 0.3, 0.2),
            "as_written/beta=one": (0.1, np.inf, 0.2),
        }
    )
    order = pipe_cells(order_tables.paper_order(results))
    assert order[ROW, "study (3)"] == "1 of 3"
    assert order[ROW, "as written (2)"] == "0 of 1"
    # The Brier scores have the reverse order here.
    assert order[ROW.replace("MMD²", "Brier score"), "study (3)"] == "0 of 3"
    lowest = pipe_cells(order_tables.lowest(results))
    assert lowest[ROW, "study (3)"] == "1 / 1 / 1"
    assert lowest[ROW, "as written (2)"] == "1 / 0 / 0"
    # The Brier scores have the reverse order here.
    assert lowest[ROW.replace("MMD²", "Brier score"), "study (3)"] == "0 / 1 / 2"
    assert len(MODELS) == 3


def test_the_advantage_by_the_score_of_the_full_vae() -> None:
    names = ["study", "study/beta=one", "study/beta=low", "as_written", "random-00"]
    full = [0.01, 0.05, 0.12, 0.15, 0.5]
    values = {name: (0.04, score, 0.3) for name, score in zip(names, full, strict=True)}
    words = ["contradicted", "undecided", "holds", "holds", "contradicted"]
    results = readings(values, dict(zip(names, words, strict=True)))
    table = pipe_cells(order_tables.by_full_vae(results))
    heads = ["points", "residual VAE ahead", "undecided", "full VAE ahead", "median difference"]
    expected = {
        "UAV, below 0.05": ["1", "0", "0", "1", "−0.030"],
        "UAV, 0.05 to 0.15": ["2", "1", "1", "0", "0.045"],
        "UAV, from 0.15": ["2", "1", "0", "1", "0.285"],
    }
    assert {row: [table[row, head] for head in heads] for row, _ in table} == expected


@pytest.mark.parametrize(
    ("base", "head", "entry"),
    [
        ("holds", "residual VAE", "full VAE ahead (1 of 3): target: state"),
        ("contradicted", "full VAE", "residual VAE ahead (2 of 3): β: low or one"),
        (
            "undecided",
            "neither",
            "residual VAE ahead (2 of 3): β: low or one; full VAE ahead (1 of 3): target: state",
        ),
    ],
)
def test_the_changes_that_turn_the_order(base: str, head: str, entry: str) -> None:
    status = {
        "study": base,
        "study/target=state": "contradicted",
        "study/beta=low": "holds",
        "study/beta=one": "holds",
        "as_written": "holds",
        "as_written/beta=one": "undecided",
    }
    table = pipe_cells(order_tables.turning(readings(dict.fromkeys(status, (1, 1, 1)), status)))
    row = "study: UAV, high epistemic"
    assert table[row, "ahead in the base reading"] == head
    assert table[row, "changes that reverse it"] == entry
    assert table["as written: UAV, high epistemic", "changes that reverse it"] == "—"
