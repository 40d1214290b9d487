"""``SHA256SUMS``: the checksum of every file of a results folder.

A run writes this file last. ``sha256sum --check SHA256SUMS`` checks the folder without Python.
"""

from collections.abc import Collection, Iterable, Sequence
from pathlib import Path

from study.common.errors import StudyError
from study.common.files import read_checksums, sha256, write_checksums
from study.common.read_back import read_back
from study.results.folder import RUN_AGAIN

NAME = "SHA256SUMS"
FILES = (
    "claims.json",
    "claims.md",
    "fits.parquet",
    "scores.parquet",
    "study.json",
    "timings.json",
    "trials.parquet",
)
FOLDERS = ("figures", "illustrations", "recordings", "tables", "weights")
"""Files and folders of a study. Other files, such as notes and ``work/``, have no checksum."""


def write(out: Path) -> None:
    """Write the checksums of all files of the study; the same files give the same bytes.

    Raises:
        StudyError: a file cannot be read back.
    """
    seal(out, present(out))


def seal(out: Path, names: Iterable[str]) -> None:
    """Read files back, and write their checksums.

    Args:
        out: the folder.
        names: of the files, relative to the folder.

    Raises:
        StudyError: a file cannot be read back.
    """
    checksums = {}
    for name in names:
        read_back(out / name)
        checksums[name] = sha256(out / name)
    write_checksums(out / NAME, checksums)


def renew(out: Path, names: Collection[str]) -> None:
    """Write new checksums of some files and folders. The checksums of other files do not change.

    Raises:
        StudyError: a file cannot be read back, or the old checksums are missing or damaged.
    """
    checksums = {
        name: value for name, value in read(out).items() if name.split("/")[0] not in names
    }
    for name in present(out):
        if name.split("/")[0] in names:
            read_back(out / name)
            checksums[name] = sha256(out / name)
    write_checksums(out / NAME, dict(sorted(checksums.items())))


def read(out: Path) -> dict[str, str]:
    """The checksums, by file name relative to `out`.

    Raises:
        StudyError: the checksums are missing or damaged.
    """
    path = out / NAME
    try:
        return read_checksums(path)
    except FileNotFoundError:
        raise StudyError(f"{path} is missing; {RUN_AGAIN}") from None
    except (OSError, ValueError) as error:
        raise StudyError(f"{path} is damaged ({error}); {RUN_AGAIN}") from None


def problems(out: Path, names: Sequence[str] | None = None) -> list[str]:
    """The files that differ from ``SHA256SUMS``, one line each.

    Lines begin with `damaged: `, `missing: ` or `not listed in SHA256SUMS: `. A folder without
    results has no problems.

    Args:
        out: the folder.
        names: of the files that should be listed; None for those of a study.
    """
    names = present(out) if names is None else names
    if not names:
        return []
    try:
        checksums = read(out)
    except StudyError:
        return [f"{'damaged' if (out / NAME).exists() else 'missing'}: {out / NAME}"]
    lines = [f"missing: {out / name}" for name in checksums if not (out / name).is_file()]
    for name in names:
        if name not in checksums:
            lines.append(f"not listed in {NAME}: {out / name}")
        elif sha256(out / name) != checksums[name]:
            lines.append(f"damaged: {out / name}")
    return sorted(lines)


def check(path: Path, out: Path) -> None:
    """Check one file of a results folder before it is used.

    Raises:
        StudyError: the file is missing, not listed, or damaged.
    """
    if not path.is_file():
        raise StudyError(f"{path} is missing; {RUN_AGAIN}")
    expected = read(out).get(path.relative_to(out).as_posix())
    if expected is None:
        raise StudyError(f"{path} is not listed in {NAME}, so it is not a file of the study")
    if sha256(path) != expected:
        raise StudyError(f"{path} is damaged: it differs from its checksum in {NAME}; {RUN_AGAIN}")


def present(out: Path) -> list[str]:
    """The sorted names of the study's files in the folder, without hidden files."""
    paths = [out / name for name in FILES]
    paths += [path for folder in FOLDERS for path in (out / folder).rglob("*")]
    names = [path.relative_to(out) for path in paths if path.is_file()]
    return sorted(name.as_posix() for name in names if not any(p[0] == "." for p in name.parts))
