"""One colour for one thing, in every view: clear on a dark and on a light background alike."""

from collections.abc import Iterable

from study.config.names import (
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

FORECAST: Colour = (62, 134, 222, 255)
OBSERVED: Colour = (150, 150, 150, 255)
TARGET: Colour = (0, 190, 80, 255)
ALEATORIC: Colour = (214, 168, 32, 255)
EPISTEMIC: Colour = (213, 94, 0, 255)
NOW: Colour = (235, 150, 30, 255)
RUN: Colour = (250, 210, 40, 255)  # in a 3D scene only: too light on a white ground
REFERENCE: Colour = (140, 140, 140, 160)
FRAME: Colour = (128, 128, 128, 255)

STATE: dict[str, Colour] = {
    "complete": (46, 160, 90, 255),
    "pruned": (235, 150, 30, 255),
    "failed": (214, 72, 60, 255),
}

# Okabe and Ito's palette, without its black and its yellow: told apart by the colour-blind too.
_SERIES = (
    (0, 114, 178),
    (213, 94, 0),
    (0, 158, 115),
    (204, 121, 167),
    (86, 180, 233),
    (230, 159, 0),
)

MODELS: dict[str, Colour] = {
    RESIDUAL: (0, 114, 178, 255),
    FULL: (213, 94, 0, 255),
    MLP: (0, 158, 115, 255),
    RESIDUAL_CRPS: (86, 180, 233, 255),
    FULL_CRPS: (230, 159, 0, 255),
    RESIDUAL_ENSEMBLE: (51, 34, 136, 255),
    FULL_ENSEMBLE: (136, 34, 85, 255),
    MLP_ENSEMBLE: (153, 153, 51, 255),
    ENSEMBLE: (204, 121, 167, 255),
    ORACLE: (119, 119, 119, 255),
}


def series(index: int) -> Colour:
    """The colour of the index-th of several series; repeats, lighter, after the sixth."""
    turn, place = divmod(index, len(_SERIES))
    red, green, blue = (channel + (255 - channel) * min(turn, 2) // 4 for channel in _SERIES[place])
    return red, green, blue, 255


def faint(colour: Colour, alpha: int) -> Colour:
    """The same colour, more transparent."""
    return (*colour[:3], alpha)


def model_colours(models: Iterable[str]) -> dict[str, Colour]:
    """A colour for each model, as in the figures; your own ones take turns."""
    others = sorted(set(models) - set(MODELS))
    return MODELS | {model: series(6 + i % 6) for i, model in enumerate(others)}
