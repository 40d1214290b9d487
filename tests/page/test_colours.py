"""Colours of figures in both themes."""

import re

import pytest

from study.page.colours import themed
from study.plotting.palette import model_colours
from study.plotting.style import hexadecimal


@pytest.mark.parametrize(("colour", "dark"), [("#000000", "currentColor"), ("#ffffff", "#141414")])
def test_black_and_white_change_sides(colour: str, dark: str) -> None:
    assert themed(colour) in (dark, f"light-dark({colour}, {dark})")


def test_models_stay_apart_and_keep_their_light_colours() -> None:
    names = ["residual_vae", "full_vae", "probabilistic_mlp", "full_crps", "residual_ensemble"]
    colours = [hexadecimal(colour).lower() for colour in model_colours(names).values()]
    both = [themed(colour) for colour in colours]
    assert all(colour in found for colour, found in zip(colours, both, strict=True))
    darks = [re.findall("#[0-9a-f]{6}", found)[-1] for found in both]
    for index, one in enumerate(darks):
        for other in darks[:index]:
            distance = sum(
                abs(int(one[i : i + 2], 16) - int(other[i : i + 2], 16)) for i in (1, 3, 5)
            )
            assert distance > 60, (one, other)
