"""Checks of this study that are not claims of the paper.

The oracle is the simulator itself. Its expected score is the lowest possible, so a model with a
lower score would show an error of this study. The other checks compare the aleatoric variance of
the two VAEs with the true variance.
"""

from itertools import product

from study.claims.claim import (
    OURS,
    SMALLEST_EFFECTS,
    Claim,
    Contrast,
    Rule,
    difference,
    minus,
)
from study.config.names import ENSEMBLE, ENVIRONMENTS, FULL, LEVELS, MODELS, ORACLE, RESIDUAL, label


def _checks() -> list[Claim]:
    checks = []
    for env in ENVIRONMENTS:
        for metric, name, figure in (
            ("mmd2", "MMD", f"figures/mmd_{env}.png"),
            ("brier", "Brier score", f"tables/brier_{env}.md"),
            ("energy_score", "energy score", "scores.parquet"),
        ):
            contrasts = tuple(
                Contrast(
                    f"{label(model)}, {label(level)}, minus oracle",
                    difference(metric, env, level, ORACLE, model).terms,
                )
                for model, level in product((*MODELS, ENSEMBLE), LEVELS)
            )
            checks.append(
                Claim(
                    f"check-{metric}-oracle-{env}",
                    OURS,
                    f"{label(env)}: no model has a lower {name} than the simulator itself "
                    "(a check on this study).",
                    contrasts,
                    Rule.NOT_BELOW,
                    SMALLEST_EFFECTS[metric],
                    figure,
                )
            )
        figure = f"figures/variance_{env}.png"
        metric = "log_aleatoric_error"
        advantages = {level: difference(metric, env, level, RESIDUAL, FULL) for level in LEVELS}
        checks += [
            Claim(
                f"aleatoric-residual-closer-{env}",
                OURS,
                f"{label(env)}: the residual VAE's aleatoric variance is closer to the true "
                "variance than the full VAE's.",
                tuple(
                    Contrast(f"{contrast.text}, {label(level)}", contrast.terms)
                    for level, contrast in advantages.items()
                ),
                Rule.ABOVE,
                SMALLEST_EFFECTS[metric],
                figure,
            ),
            Claim(
                f"aleatoric-residual-closer-with-little-data-{env}",
                OURS,
                f"{label(env)}: that advantage is larger where epistemic uncertainty is high.",
                (minus(advantages["high"], advantages["low"], "advantage, high minus low"),),
                Rule.ABOVE,
                SMALLEST_EFFECTS[metric],
                figure,
            ),
        ]
    return checks


CHECKS = tuple(_checks())
