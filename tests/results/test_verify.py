"""When two files with different bytes have the same content."""

from pathlib import Path

import numpy as np
from matplotlib import pyplot
from matplotlib.image import imread, imsave

from study.common.files import same_bytes, write_json
from study.results.verify import compare_files, content_difference


def test_a_picture_in_other_bytes_has_the_same_content(tmp_path: Path) -> None:
    published, expected = (
        tmp_path / folder / "figures" / "curve.png" for folder in ("published", "expected")
    )
    for path in (published, expected):
        path.parent.mkdir(parents=True)
    figure, axes = pyplot.subplots()
    axes.plot(np.sin(np.arange(30.0)))
    figure.savefig(published)
    figure.savefig(expected, metadata={"Title": "other bytes"})
    pyplot.close(figure)
    assert not same_bytes(published, expected)
    found = compare_files("figures", tmp_path / "published", tmp_path / "expected", "figures/*")
    assert found.ok
    assert found.text.endswith("or in 1 of them the same content")
    pixels = np.array(imread(expected))
    pixels[0, 0, 0] = 1 - pixels[0, 0, 0]
    imsave(expected, pixels)
    found = compare_files("figures", tmp_path / "published", tmp_path / "expected", "figures/*")
    assert not found.ok
    assert "of its pixels" in found.text


def test_claims_are_compared_to_nine_digits(tmp_path: Path) -> None:
    ours, theirs = (tmp_path / name / "claims.json" for name in ("ours", "theirs"))

    def compared(claims: object) -> bool:
        write_json(theirs, claims)
        assert not same_bytes(ours, theirs)
        return compare_files("claims", ours.parent, theirs.parent, "claims.*").ok

    claim: dict[str, object] = {
        "text": "the first is lower",
        "findings": [{"effect": 0.3, "seeds": 2}],
    }
    write_json(ours, [claim])
    assert compared([claim | {"findings": [{"effect": 0.3 * (1 + 1e-13), "seeds": 2}]}])
    assert not compared([claim | {"findings": [{"effect": 0.3 * (1 + 1e-6), "seeds": 2}]}])
    assert not compared([claim | {"findings": [{"effect": 0.3, "seeds": 3}]}])
    assert not compared([claim | {"text": "the second is lower"}])
    assert not compared([claim, claim])
    assert not compared([{"text": claim["text"]}])
    ours.write_text("[")
    assert content_difference(ours, theirs) == "is not a JSON file"


def test_a_pdf_in_other_bytes_has_the_same_content(tmp_path: Path) -> None:
    paths = [tmp_path / f"{name}.pdf" for name in ("packed", "repacked", "another")]
    for path, level, height in zip(paths, (9, 1, 9), (1.0, 1.0, 1.1), strict=True):
        with pyplot.rc_context({"pdf.compression": level}):
            figure, axes = pyplot.subplots()
            axes.plot(np.sin(np.arange(300.0)) * height)
            figure.savefig(path, metadata={"CreationDate": None})
            pyplot.close(figure)
    assert paths[0].read_bytes() != paths[1].read_bytes()
    assert content_difference(paths[0], paths[1]) is None
    assert content_difference(paths[0], paths[2]) is not None
