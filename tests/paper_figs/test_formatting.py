"""Numbers and LaTeX of tables."""

import numpy as np

from paper_figs.formatting import beyond, latex, number
from study.config.names import FULL, RESIDUAL_CRPS


def test_numbers_that_are_not_finite_and_negative_zero() -> None:
    assert number(None, 2) == number(np.nan, 2) == "—"
    assert number(np.inf, 2) == "∞"
    assert number(-0.0001, 3) == "0.000"
    assert number(-0.25, 2) == "−0.25"


def test_latex_of_numbers_and_percent() -> None:
    assert latex("95 % of −0.1, 5%: MMD², × ½") == (
        "95\\,\\% of $-$0.1, 5\\%: MMD$^2$, $\\times\\frac{1}{2}$"
    )


def test_only_models_beyond_the_paper_have_a_note() -> None:
    assert beyond([FULL, RESIDUAL_CRPS]) == ["† Beyond the paper."]
    assert beyond([FULL]) == []
