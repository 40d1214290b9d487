"""The colours of a figure in the light and in the dark theme of the page."""

INK, GROUND = 228, 20
"""Lightness of text and of the ground in the dark theme, from 0 to 255."""
LEAST_LUMINANCE = 0.15
"""Relative luminance of a hue in the dark theme, at least: a contrast of more than 3 to the ground.
Hues that are lighter still get too close to each other."""
GREYEST = 24
"""Largest difference between red, green and blue of a grey."""


def themed(colour: str) -> str:
    """A colour for both themes: a grey changes sides, and a hue that is too dark becomes lighter.

    >>> themed("#d55e00"), themed("#332288"), themed("#e6e6e6")
    ('#d55e00', 'light-dark(#332288, #7064ac)', 'light-dark(#e6e6e6, #282828)')
    """
    channels = [int(colour[start : start + 2], 16) for start in (1, 3, 5)]
    if set(channels) == {0}:
        return "currentColor"
    if max(channels) - min(channels) <= GREYEST:
        dark = [round(INK - (INK - GROUND) * channel / 255) for channel in channels]
    else:
        dark = _lightened(channels)
    if dark == channels:
        return colour
    return f"light-dark({colour}, #{''.join(f'{channel:02x}' for channel in dark)})"


def _lightened(channels: list[int]) -> list[int]:
    """A hue mixed with as little white as its luminance needs."""
    for share in range(101):
        mixed = [round(channel + (255 - channel) * share / 100) for channel in channels]
        if _luminance(mixed) >= LEAST_LUMINANCE:
            return mixed
    return [255, 255, 255]


def _luminance(channels: list[int]) -> float:
    """Relative luminance of sRGB, as in the Web Content Accessibility Guidelines."""
    linear = [
        value / 12.92 if value <= 0.04045 else ((value + 0.055) / 1.055) ** 2.4
        for value in (channel / 255 for channel in channels)
    ]
    red, green, blue = linear
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue
