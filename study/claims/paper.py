"""What the paper says, as data: the values of its tables, and the claims of its results section.

Rules and least effects were fixed before any run. Claims are of the two environments of the paper
and of no other.
"""

from dataclasses import dataclass
from enum import Enum
from itertools import product

from study.config.names import (
    ENSEMBLE,
    ENVIRONMENTS,
    FULL,
    LEVELS,
    MLP,
    MODELS,
    ORACLE,
    RESIDUAL,
    label,
)

BRIER = {
    ("pusher", "low", RESIDUAL): 0.072,
    ("pusher", "low", FULL): 0.391,
    ("pusher", "low", MLP): 0.416,
    ("pusher", "high", RESIDUAL): 0.061,
    ("pusher", "high", FULL): 0.439,
    ("pusher", "high", MLP): 0.539,
    ("uav", "low", RESIDUAL): 0.190,
    ("uav", "low", FULL): 0.272,
    ("uav", "low", MLP): 0.712,
    ("uav", "high", RESIDUAL): 0.245,
    ("uav", "high", FULL): 0.327,
    ("uav", "high", MLP): 0.782,
}
"""Tables I and II: Brier score by environment, level and model."""

LEAST = {
    "mmd2": 0.002,
    "brier": 0.01,
    "energy_score": 0.005,
    "log_aleatoric_error": 0.05,
    "log_aleatoric_ratio": 0.05,
}
"""Least effect that counts, by metric.

MMD²: that of two normal distributions a tenth of a standard deviation apart, under the median
heuristic. Brier score: a probability that is off by 0.1. Energy score: a two-hundredth of the
training data's standard deviation. Variance: a factor 5 % further off.
"""

MARGIN = 0.25
"""Two values are comparable if they differ by less than this share of their mean."""


class Rule(Enum):
    """When a contrast (an average with its 95 % interval) holds, and when it is contradicted.

    In between it is undecided.
    """

    ABOVE = "above zero"
    """Holds: the interval is above 0 and the effect at least the least one. Contradicted: the
    interval is below the least effect, so any advantage is too small to matter; ties are here."""
    EQUAL = "within a margin of zero"
    """Holds: the interval lies within the margin, an equivalence test. Contradicted: the interval
    lies outside it."""
    NOT_BELOW = "not below zero"
    """Holds, unless the interval is below 0 and the effect is at least the least one below it."""


@dataclass(frozen=True)
class Quantity:
    """The mean of one metric over scenarios (dimensions, for variances) and seeds."""

    metric: str
    environment: str
    level: str
    model: str


@dataclass(frozen=True)
class Contrast:
    """A weighted sum of quantities, in words."""

    words: str
    terms: tuple[tuple[float, Quantity], ...]


@dataclass(frozen=True)
class Claim:
    """A sentence of the results section, or a check of our own, that numbers can decide."""

    id: str
    section: str
    words: str
    contrasts: tuple[Contrast, ...]
    rule: Rule
    least: float
    """Least effect that counts."""
    figure: str
    """Where to see it, relative to the folder of the results."""


def _less(metric: str, environment: str, level: str, low: str, high: str) -> Contrast:
    """`low` scores less than `high`."""
    return Contrast(
        f"{label(high)} minus {label(low)}",
        (
            (1.0, Quantity(metric, environment, level, high)),
            (-1.0, Quantity(metric, environment, level, low)),
        ),
    )


def _rise(metric: str, environment: str, model: str) -> Contrast:
    """`model` scores higher where there is less data."""
    return Contrast(
        f"{label(model)}, high minus low",
        (
            (1.0, Quantity(metric, environment, "high", model)),
            (-1.0, Quantity(metric, environment, "low", model)),
        ),
    )


def _minus(first: Contrast, second: Contrast, words: str) -> Contrast:
    negated = tuple((-weight, quantity) for weight, quantity in second.terms)
    return Contrast(words, first.terms + negated)


def _where(environment: str) -> str:
    return {"pusher": "V-A", "uav": "V-B"}[environment]


def _at(environment: str, level: str) -> str:
    return f"{label(environment)}, {label(level)}"


def _mmd_claims() -> list[Claim]:
    claims = []
    for env, level in product(ENVIRONMENTS, LEVELS):
        figure = f"figures/mmd_{env}.png"
        claims += [
            Claim(
                f"mmd-residual-lowest-{env}-{level}",
                _where(env),
                f"{_at(env, level)}: of the three models the residual VAE has the lowest MMD.",
                tuple(_less("mmd2", env, level, RESIDUAL, other) for other in (FULL, MLP)),
                Rule.ABOVE,
                LEAST["mmd2"],
                figure,
            ),
            Claim(
                f"mmd-mlp-highest-{env}-{level}",
                _where(env),
                f"{_at(env, level)}: the probabilistic MLP has the highest MMD.",
                tuple(_less("mmd2", env, level, other, MLP) for other in (RESIDUAL, FULL)),
                Rule.ABOVE,
                LEAST["mmd2"],
                figure,
            ),
        ]
    for env in ENVIRONMENTS:
        figure = f"figures/mmd_{env}.png"
        claims.append(
            Claim(
                f"mmd-full-rises-{env}",
                _where(env),
                f"{label(env)}: the full VAE's MMD is higher where epistemic uncertainty is high.",
                (_rise("mmd2", env, FULL),),
                Rule.ABOVE,
                LEAST["mmd2"],
                figure,
            )
        )
        claims += [
            Claim(
                f"mmd-steady-{env}-{model}",
                _where(env),
                f"{label(env)}: the MMD of the {label(model)} is comparable at both levels.",
                (_rise("mmd2", env, model),),
                Rule.EQUAL,
                LEAST["mmd2"],
                figure,
            )
            for model in (RESIDUAL, MLP)
        ]
    full_on_uav = _rise("mmd2", "uav", FULL)
    return [
        *claims,
        Claim(
            "mmd-full-rises-most-uav",
            "V-B",
            "UAV: the full VAE's MMD rises more with epistemic uncertainty than the other two's.",
            tuple(
                _minus(
                    full_on_uav, _rise("mmd2", "uav", other), f"rise beyond the {label(other)}'s"
                )
                for other in (RESIDUAL, MLP)
            ),
            Rule.ABOVE,
            LEAST["mmd2"],
            "figures/mmd_uav.png",
        ),
        Claim(
            "mmd-full-rises-more-uav-than-pusher",
            "V-B",
            "The full VAE's MMD rises more on the UAV than on the Pusher.",
            (_minus(full_on_uav, _rise("mmd2", "pusher", FULL), "UAV's rise minus Pusher's"),),
            Rule.ABOVE,
            LEAST["mmd2"],
            "figures/mmd_uav.png",
        ),
        Claim(
            "mmd-uav-larger",
            "V-B",
            "MMD is larger on the UAV than on the Pusher, for each model and level.",
            tuple(
                Contrast(
                    f"{label(model)}, {label(level)}, UAV minus Pusher",
                    (
                        (1.0, Quantity("mmd2", "uav", level, model)),
                        (-1.0, Quantity("mmd2", "pusher", level, model)),
                    ),
                )
                for model, level in product(MODELS, LEVELS)
            ),
            Rule.ABOVE,
            LEAST["mmd2"],
            "figures/mmd_uav.png",
        ),
    ]


def _brier_claims() -> list[Claim]:
    orders = [
        Claim(
            f"brier-order-{env}-{level}",
            _where(env),
            f"{_at(env, level)}: the Brier score is lowest for the residual VAE, then the full "
            "VAE, and highest for the probabilistic MLP.",
            (
                _less("brier", env, level, RESIDUAL, FULL),
                _less("brier", env, level, FULL, MLP),
            ),
            Rule.ABOVE,
            LEAST["brier"],
            f"tables/brier_{env}.md",
        )
        for env, level in product(ENVIRONMENTS, LEVELS)
    ]
    rise = Claim(
        "brier-rises-uav",
        "V-B",
        "UAV: the Brier scores of all three models are higher where epistemic uncertainty is high.",
        tuple(_rise("brier", "uav", model) for model in MODELS),
        Rule.ABOVE,
        LEAST["brier"],
        "tables/brier_uav.md",
    )
    return [*orders, rise]


def _double_counting() -> Claim:
    """Section V-B supposes it; the true aleatoric variance decides it."""
    metric = "log_aleatoric_ratio"
    too_wide = Contrast(
        "log of the full VAE's aleatoric variance over the true, high epistemic",
        ((1.0, Quantity(metric, "uav", "high", FULL)),),
    )
    return Claim(
        "double-counting-uav",
        "V-B",
        "UAV: the full VAE counts epistemic uncertainty twice: its aleatoric variance is above the "
        "true one where there is little data, and more so than where there is much.",
        (too_wide, _rise(metric, "uav", FULL)),
        Rule.ABOVE,
        LEAST[metric],
        "figures/variance_uav.png",
    )


def _own_claims() -> list[Claim]:
    claims = []
    for env in ENVIRONMENTS:
        for metric, name, figure in (
            ("mmd2", "MMD", f"figures/mmd_{env}.png"),
            ("brier", "Brier score", f"tables/brier_{env}.md"),
            ("energy_score", "energy score", "scores.parquet"),
        ):
            contrasts = tuple(
                Contrast(
                    f"{label(model)}, {label(level)}, minus oracle",
                    _less(metric, env, level, ORACLE, model).terms,
                )
                for model, level in product((*MODELS, ENSEMBLE), LEVELS)
            )
            claims.append(
                Claim(
                    f"check-{metric}-oracle-{env}",
                    "ours",
                    f"{label(env)}: no model has a lower {name} than the simulator itself "
                    "(a check on this study).",
                    contrasts,
                    Rule.NOT_BELOW,
                    LEAST[metric],
                    figure,
                )
            )
        figure = f"figures/variance_{env}.png"
        metric = "log_aleatoric_error"
        gains = {level: _less(metric, env, level, RESIDUAL, FULL) for level in LEVELS}
        claims += [
            Claim(
                f"aleatoric-residual-closer-{env}",
                "ours",
                f"{label(env)}: the residual VAE's aleatoric variance is closer to the true "
                "variance than the full VAE's.",
                tuple(
                    Contrast(f"{g.words}, {label(level)}", g.terms) for level, g in gains.items()
                ),
                Rule.ABOVE,
                LEAST[metric],
                figure,
            ),
            Claim(
                f"aleatoric-residual-closer-with-little-data-{env}",
                "ours",
                f"{label(env)}: that advantage is larger where epistemic uncertainty is high.",
                (_minus(gains["high"], gains["low"], "advantage, high minus low"),),
                Rule.ABOVE,
                LEAST[metric],
                figure,
            ),
        ]
    return claims


CLAIMS = (*_mmd_claims(), *_brier_claims(), _double_counting(), *_own_claims())
