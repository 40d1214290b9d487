"""Numbers and LaTeX of tables."""

import numpy as np

from paper_figs.formatting import beyond, latex, number
from study.config.names import FULL, RESIDUAL_CRPS, markdown


def test_numbers_that_are_not_finite_and_negative_zero() -> None:
    assert number(None, 2) == number(np.nan, 2) == "—"
    assert number(np.inf, 2) == "∞"
    assert number(-0.0001, 3) == "0.000"
    assert number(-0.25, 2) == "−0.25"


def test_latex_of_numbers_and_percent() -> None:
    assert latex("95 % of −0.1, 5%: MMD², × ½") == (
        "95\\,\\% of $-$0.1, 5\\%: MMD$^2$, $\\times\\frac{1}{2}$"
    )


def test_latex_of_what_a_user_may_call_an_outcome() -> None:
    assert latex("50%_a&b#c$d") == "50\\%\\_a\\&b\\#c\\$d"
    assert latex("{x}^2 ~ \\y") == (
        "\\{x\\}\\textasciicircum{}2 \\textasciitilde{} \\textbackslash{}y"
    )


def test_markdown_of_what_a_user_may_call_an_outcome() -> None:
    assert markdown("|x| < *1* & `a`\nb") == "\\|x\\| &lt; \\*1\\* &amp; \\`a\\` b"
    assert markdown("p_x ẋ m/s²") == "p_x ẋ m/s²"


def test_only_models_beyond_the_paper_have_a_note() -> None:
    assert beyond([FULL, RESIDUAL_CRPS]) == ["† Beyond the paper."]
    assert beyond([FULL]) == []
