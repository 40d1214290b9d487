"""One colour for each model, in figures and recordings alike."""

import pytest

from study.config.names import BEYOND, ENSEMBLE, MODELS, ORACLE
from study.plotting import style
from study.plotting.palette import model_colour_names, model_colours, series

NAMED = (*MODELS, *BEYOND, ENSEMBLE, ORACLE)


def test_colours_of_models_are_distinct() -> None:
    models = [*NAMED, "a", "b", "c", "d"]
    assert len(set(model_colours(models).values())) == len(models)
    assert len(set(model_colour_names(models).values())) == len(models)


def test_the_colour_of_another_model_does_not_depend_on_the_order() -> None:
    assert model_colours(["b", "a"]) == model_colours(["a", "b", "b", *MODELS])


def test_figures_have_the_colours_of_recordings() -> None:
    for model, colour in model_colours(["a", "b"]).items():
        assert bytes.fromhex(style.colours(["a", "b"])[model][1:]) == bytes(colour[:3])


@pytest.mark.parametrize("count", [6, 18])
def test_series_repeat_lighter(count: int) -> None:
    colours = [series(index) for index in range(count)]
    assert len(set(colours)) == count
    assert all(sum(series(i + 6)) > sum(series(i)) for i in range(6))
