"""A multiverse with known effects: a sum of what each value adds."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from study.claims.judge import CLAIMS
from study.multiverse.design import Design
from study.multiverse.effects import COLUMNS, join
from study.multiverse.folder import Failure, Multiverse
from study.multiverse.read import design_from
from study.multiverse.universes import universes

FORECAST: dict[str, Any] = {
    "question": "What is a forecast state?",
    "values": {
        "sample": {"vae.decoder_output": "sample"},
        "mean": {"vae.decoder_output": "mean"},
    },
}
"""A choice of two values."""

PART: dict[str, Any] = {
    "bases": {"study": {}, "as_written": {"forecast": "mean", "target": "state", "beta": "low"}},
    "random": 12,
    "further_seeds": [1],
    "choices": {
        "forecast": FORECAST,
        "target": {
            "question": "What does the decoder predict?",
            "values": {"change": {"vae.target": "delta"}, "state": {"vae.target": "state"}},
        },
        "beta": {
            "question": "In which range is β searched?",
            "values": {
                "high": {},
                "low": {"tune.beta_low": 0.001, "tune.beta_high": 1.0},
                "one": {"tune.beta_low": 1.0, "tune.beta_high": 1.0},
            },
        },
        "features": {
            "question": "Do the networks have a product stem?",
            "values": {
                "product": {"network.features": "product"},
                "none": {"network.features": "none"},
            },
        },
    },
    "exclude": [
        {"values": {"forecast": "mean", "beta": "high"}, "reason": "no forecast would have noise"}
    ],
}
"""The part `multiverse` of a file of settings: four choices, of which one has three values."""

ADDED: Mapping[tuple[str, str], float] = {
    ("forecast", "mean"): 0.08,
    ("target", "state"): -0.02,
    ("beta", "one"): -0.05,
}
"""What each value adds to the effect of the first claim."""
CONSTANT, HALF = -0.03, 0.012
"""The effect with the first value of every choice, and half the width of all intervals."""
SCATTER = 0.002
"""Standard deviation around the sum."""


def design(**changes: Any) -> Design:
    """The design of `PART`, with some of its entries replaced."""
    return design_from(PART | changes)


def multiverse(**changes: Any) -> Multiverse:
    """Results of the design: effects of the first four claims, and one universe that failed.

    The cells have seed 0, and those of the base reading `study` seed 1 too.
    """
    planned = design(**changes)
    every = universes(planned)
    *complete, failed = every
    generator = np.random.default_rng(5)
    rows: list[dict[str, Any]] = []
    for number, claim in enumerate(CLAIMS[:4]):
        for universe in complete:
            added = sum(ADDED.get(pair, 0.0) for pair in universe.values.items())
            effect = CONSTANT + added * (-1) ** number + SCATTER * generator.normal()
            rows += _rows(universe.name, claim.id, effect)
    effects = join([pd.DataFrame(rows, columns=list(COLUMNS))])
    cells = pd.DataFrame(
        [
            {
                "universe": universe.name,
                "environment": "pusher",
                "level": "low",
                "model": model,
                "seed": 0,
                "mmd2": 0.1,
                "brier": 0.2,
                "energy_score": 0.3,
                "beta": np.nan if model == "probabilistic_mlp" else 40.0,
                "kl": np.nan,
            }
            for universe in complete
            for model in ("residual_vae", "probabilistic_mlp")
        ]
    )
    repeats = cells[cells["universe"] == "study"].assign(seed=1, mmd2=0.123)
    failure = Failure(
        failed.name, "pusher/low/full_vae/seed-0", "train pusher/low/full_vae/seed-0", "it | broke"
    )
    facts = {"settings": {"name": "toy"}, "versions": {"python": "3"}}
    return Multiverse(planned, every, effects, cells, repeats, [failure], facts)


def _rows(universe: str, claim: str, effect: float) -> list[dict[str, Any]]:
    """A decisive contrast and one with a larger effect."""
    low, high = effect - HALF, effect + HALF
    verdict = "reproduced" if low > 0 else "not reproduced" if high < 0 else "inconclusive"
    status = {"reproduced": "holds", "not reproduced": "contradicted"}.get(verdict, "undecided")
    common = {
        "universe": universe,
        "claim": claim,
        "verdict": verdict,
        "status": status,
        "margin": 0.002,
        "scenarios": 60,
        "seeds": 2,
    }
    return [
        common | {"contrast": "A", "decisive": True, "effect": effect, "low": low, "high": high},
        common
        | {
            "contrast": "B",
            "decisive": False,
            "effect": effect + 1,
            "low": low + 1,
            "high": high + 1,
        },
    ]
