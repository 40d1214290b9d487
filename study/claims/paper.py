"""The results of the paper as data: its Tables I and II, and the claims of its section IV.

The claims are about the paper's two environments and three models only. Their smallest effects
of interest were fixed before any run.
"""

from itertools import product

from study.claims.claim import (
    SMALLEST_EFFECTS,
    Claim,
    Contrast,
    Quantity,
    Rule,
    difference,
    minus,
    rise,
)
from study.config.names import ENVIRONMENTS, FULL, LEVELS, MLP, MODELS, RESIDUAL, label

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
"""Tables I and II: Brier scores by environment, level and model."""


def _section(environment: str) -> str:
    """The section of the paper about an environment."""
    return {"pusher": "IV-A", "uav": "IV-B"}[environment]


def _place(environment: str, level: str) -> str:
    """The first words of a claim."""
    return f"{label(environment)}, {label(level)}"


def _mmd_claims() -> list[Claim]:
    claims = []
    for env, level in product(ENVIRONMENTS, LEVELS):
        figure = f"figures/mmd_{env}.png"
        claims += [
            Claim(
                f"mmd-residual-lowest-{env}-{level}",
                _section(env),
                f"{_place(env, level)}: of the three models the residual VAE has the lowest MMD.",
                tuple(difference("mmd2", env, level, RESIDUAL, other) for other in (FULL, MLP)),
                Rule.ABOVE,
                SMALLEST_EFFECTS["mmd2"],
                figure,
            ),
            Claim(
                f"mmd-mlp-highest-{env}-{level}",
                _section(env),
                f"{_place(env, level)}: the probabilistic MLP has the highest MMD.",
                tuple(difference("mmd2", env, level, other, MLP) for other in (RESIDUAL, FULL)),
                Rule.ABOVE,
                SMALLEST_EFFECTS["mmd2"],
                figure,
            ),
        ]
    for env in ENVIRONMENTS:
        figure = f"figures/mmd_{env}.png"
        claims.append(
            Claim(
                f"mmd-full-rises-{env}",
                _section(env),
                f"{label(env)}: the full VAE's MMD is higher where epistemic uncertainty is high.",
                (rise("mmd2", env, FULL),),
                Rule.ABOVE,
                SMALLEST_EFFECTS["mmd2"],
                figure,
            )
        )
        claims += [
            Claim(
                f"mmd-steady-{env}-{model}",
                _section(env),
                f"{label(env)}: the MMD of the {label(model)} is comparable at both levels.",
                (rise("mmd2", env, model),),
                Rule.EQUAL,
                SMALLEST_EFFECTS["mmd2"],
                figure,
            )
            for model in (RESIDUAL, MLP)
        ]
    full_on_uav = rise("mmd2", "uav", FULL)
    return [
        *claims,
        Claim(
            "mmd-full-rises-most-uav",
            "IV-B",
            "UAV: the full VAE's MMD rises more with epistemic uncertainty than the other two's.",
            tuple(
                minus(full_on_uav, rise("mmd2", "uav", other), f"rise beyond the {label(other)}'s")
                for other in (RESIDUAL, MLP)
            ),
            Rule.ABOVE,
            SMALLEST_EFFECTS["mmd2"],
            "figures/mmd_uav.png",
        ),
        Claim(
            "mmd-full-rises-more-uav-than-pusher",
            "IV-B",
            "The full VAE's MMD rises more on the UAV than on the Pusher.",
            (minus(full_on_uav, rise("mmd2", "pusher", FULL), "UAV's rise minus Pusher's"),),
            Rule.ABOVE,
            SMALLEST_EFFECTS["mmd2"],
            "figures/mmd_uav.png",
        ),
        Claim(
            "mmd-uav-larger",
            "IV-B",
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
            SMALLEST_EFFECTS["mmd2"],
            "figures/mmd_uav.png",
        ),
    ]


def _brier_claims() -> list[Claim]:
    orders = [
        Claim(
            f"brier-order-{env}-{level}",
            _section(env),
            f"{_place(env, level)}: the Brier score is lowest for the residual VAE, then the full "
            "VAE, and highest for the probabilistic MLP.",
            (
                difference("brier", env, level, RESIDUAL, FULL),
                difference("brier", env, level, FULL, MLP),
            ),
            Rule.ABOVE,
            SMALLEST_EFFECTS["brier"],
            f"tables/brier_{env}.md",
        )
        for env, level in product(ENVIRONMENTS, LEVELS)
    ]
    higher_with_less_data = Claim(
        "brier-rises-uav",
        "IV-B",
        "UAV: the Brier scores of all three models are higher where epistemic uncertainty is high.",
        tuple(rise("brier", "uav", model) for model in MODELS),
        Rule.ABOVE,
        SMALLEST_EFFECTS["brier"],
        "tables/brier_uav.md",
    )
    return [*orders, higher_with_less_data]


def _double_counting() -> Claim:
    """A conjecture of section IV-B, which the true aleatoric variance can decide."""
    metric = "log_aleatoric_ratio"
    above_true = Contrast(
        "log of the full VAE's aleatoric variance over the true, high epistemic",
        ((1.0, Quantity(metric, "uav", "high", FULL)),),
    )
    return Claim(
        "double-counting-uav",
        "IV-B",
        "UAV: the full VAE counts epistemic uncertainty twice: its aleatoric variance is above the "
        "true one where there is little data, and more so than where there is much.",
        (above_true, rise(metric, "uav", FULL)),
        Rule.ABOVE,
        SMALLEST_EFFECTS[metric],
        "figures/variance_uav.png",
    )


PAPER_CLAIMS = (*_mmd_claims(), *_brier_claims(), _double_counting())
