"""PNG files with few colours and with texts."""

from pathlib import Path

import numpy as np
from PIL import Image

from study.plotting.png import read_texts, save_image


def test_an_image_keeps_its_few_colours_and_its_texts(tmp_path: Path) -> None:
    pixels = np.zeros((4, 6, 3), dtype=np.uint8)
    pixels[:2] = (250, 10, 20)
    path = save_image(Image.fromarray(pixels), tmp_path / "new" / "a.png", texts={"key": "a value"})
    with Image.open(path) as image:
        np.testing.assert_array_equal(np.asarray(image.convert("RGB")), pixels)
    assert read_texts(path)["key"] == "a value"


def test_the_same_image_gives_the_same_bytes(tmp_path: Path) -> None:
    generator = np.random.default_rng(0)
    image = Image.fromarray(generator.integers(0, 255, (32, 32, 3), dtype=np.uint8))
    one, other = (save_image(image, tmp_path / name) for name in ("a.png", "b.png"))
    assert one.read_bytes() == other.read_bytes()
