"""One checksum for every file of a results folder, in ``SHA256SUMS``.

The report step writes it last. ``sha256sum -c SHA256SUMS`` reads it as well, with no Python.
"""

from pathlib import Path

from study.common.errors import StudyError
from study.common.files import sha256, write_text

NAME = "SHA256SUMS"
# What the study leaves behind; work/ is scratch, and whatever else lies there is not the study's.
FILES = (
    "claims.json",
    "claims.md",
    "scores.parquet",
    "study.json",
    "timings.json",
    "trials.parquet",
)
FOLDERS = ("figures", "illustrations", "recordings", "tables", "weights")


def write(out: Path) -> None:
    """Write the checksum of every file that is there; the same files give the same bytes."""
    lines = [f"{sha256(out / name)}  {name}\n" for name in present(out)]
    write_text(out / NAME, "".join(lines))


def read(out: Path) -> dict[str, str]:
    """The checksum of every file, by its name in the folder.

    Raises:
        StudyError: there are none, or they cannot be read.
    """
    try:
        lines = (out / NAME).read_text(encoding="utf-8").splitlines()
        pairs = [line.split("  ", 1) for line in lines]
        sums = {name: digest for digest, name in pairs}
    except FileNotFoundError:
        raise StudyError(
            f"{out / NAME} is missing; python -m study.run all writes it again"
        ) from None
    except (OSError, ValueError) as error:
        raise StudyError(f"{out / NAME} is damaged: {error}") from None
    if not sums:
        raise StudyError(f"{out / NAME} is empty; python -m study.run all writes it again")
    return sums


def problems(out: Path) -> list[str]:
    """What is not as it was written: one line a file, `damaged: …`, `missing: …`, `not listed: …`.

    Nothing for a folder that has no results at all.
    """
    there = present(out)
    if not there:
        return []
    try:
        sums = read(out)
    except StudyError:
        return [f"{'damaged' if (out / NAME).exists() else 'missing'}: {out / NAME}"]
    found = [f"missing: {out / name}" for name in sums if not (out / name).is_file()]
    for name in there:
        if name not in sums:
            found.append(f"not listed in {NAME}: {out / name}")
        elif sha256(out / name) != sums[name]:
            found.append(f"damaged: {out / name}")
    return sorted(found)


def check(path: Path, out: Path) -> None:
    """Check one file of a results folder before it is trusted.

    Raises:
        StudyError: it is missing, is not listed, or is not what was written.
    """
    if not path.is_file():
        raise StudyError(f"{path} is missing")
    expected = read(out).get(path.relative_to(out).as_posix())
    if expected is None:
        raise StudyError(f"{path} is not listed in {NAME}: it is none of the study's files")
    if sha256(path) != expected:
        raise StudyError(
            f"{path} is damaged: it is not what {NAME} says; restore it, "
            "or make it again: python -m study.run all"
        )


def present(out: Path) -> list[str]:
    """The study's files in the folder, by name, in order. Hidden ones are not its own."""
    found = [out / name for name in FILES]
    found += [path for folder in FOLDERS for path in (out / folder).rglob("*")]
    names = [path.relative_to(out) for path in found if path.is_file()]
    return sorted(name.as_posix() for name in names if not any(p[0] == "." for p in name.parts))
