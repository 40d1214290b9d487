"""The colours of figures and recordings. A model or a quantity has the same colour everywhere.

The colours are those of Okabe and Ito (2008) and of Paul Tol. They can be distinguished with any
colour vision.
"""

from collections.abc import Iterable

from study.config.names import (
    CRPS_ENSEMBLE,
    ENSEMBLE,
    FULL,
    FULL_CRPS,
    FULL_ENSEMBLE,
    MLP,
    MLP_ENSEMBLE,
    ORACLE,
    RESIDUAL,
    RESIDUAL_CRPS,
    RESIDUAL_ENSEMBLE,
)

Colour = tuple[int, int, int, int]
"""Red, green, blue and opacity, each from 0 to 255."""

FORECAST: Colour = (62, 134, 222, 255)
OBSERVED: Colour = (150, 150, 150, 255)
TARGET: Colour = (0, 190, 80, 255)
ALEATORIC: Colour = (214, 168, 32, 255)
EPISTEMIC: Colour = (213, 94, 0, 255)
HIGHLIGHT: Colour = (235, 150, 30, 255)
"""The selected trajectory in a view with many."""
REPLAYED: Colour = (250, 210, 40, 255)
"""The rollout that the bodies of a 3D scene replay; too light for a white ground."""
REFERENCE: Colour = (140, 140, 140, 160)
"""Lines to compare with, such as the diagonal of a reliability diagram."""
FRAME: Colour = (128, 128, 128, 255)

TRIAL_STATES: dict[str, Colour] = {
    "complete": (46, 160, 90, 255),
    "pruned": (235, 150, 30, 255),
    "failed": (214, 72, 60, 255),
}

VERDICTS: dict[str, Colour] = {
    "reproduced": (0, 158, 115, 255),
    "partly": (86, 180, 233, 255),
    "inconclusive": (150, 150, 150, 255),
    "not reproduced": (213, 94, 0, 255),
}
"""The colour of each verdict on a claim, from the best to the worst."""

_RGB = {
    "blue": (0, 114, 178),
    "vermilion": (213, 94, 0),
    "green": (0, 158, 115),
    "pink": (204, 121, 167),
    "light blue": (86, 180, 233),
    "orange": (230, 159, 0),
    "indigo": (51, 34, 136),
    "wine": (136, 34, 85),
    "olive": (153, 153, 51),
    "grey": (119, 119, 119),
    "teal": (68, 170, 153),
    "purple": (170, 68, 153),
    "sand": (221, 204, 119),
    "brown": (140, 86, 48),
    "rose": (204, 102, 119),
}
_MODELS = {
    RESIDUAL: "blue",
    FULL: "vermilion",
    MLP: "green",
    RESIDUAL_CRPS: "light blue",
    FULL_CRPS: "orange",
    CRPS_ENSEMBLE: "rose",
    RESIDUAL_ENSEMBLE: "indigo",
    FULL_ENSEMBLE: "wine",
    MLP_ENSEMBLE: "olive",
    ENSEMBLE: "pink",
    ORACLE: "grey",
}
_OTHER_MODELS = ("teal", "purple", "sand", "brown")
_SERIES = ("blue", "vermilion", "green", "pink", "light blue", "orange")


def model_colour_names(models: Iterable[str]) -> dict[str, str]:
    """The names of the colours of the study's models and of `models`, by model.

    Models from plugins take four further colours in turn, in alphabetical order.
    """
    unknown = sorted(set(models) - set(_MODELS))
    return _MODELS | {
        model: _OTHER_MODELS[index % len(_OTHER_MODELS)] for index, model in enumerate(unknown)
    }


def model_colours(models: Iterable[str]) -> dict[str, Colour]:
    """The colours of the study's models and of `models`, by model."""
    return {model: (*_RGB[name], 255) for model, name in model_colour_names(models).items()}


def series(index: int) -> Colour:
    """The colour of one of several series: six in turn, then the same six lighter."""
    turn, position = divmod(index, len(_SERIES))
    rgb = _RGB[_SERIES[position]]
    red, green, blue = (channel + (255 - channel) * min(turn, 2) // 4 for channel in rgb)
    return red, green, blue, 255


def faint(colour: Colour, opacity: int) -> Colour:
    """The same colour with another opacity, from 0 to 255."""
    return (*colour[:3], opacity)
