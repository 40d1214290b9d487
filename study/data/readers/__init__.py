"""Readers of logs. A format is one module with a function ``read(path) -> list[Table]``.

A table has the columns that were sampled at the same times. A CSV file is one table, and a log with
topics at different rates is one table for each topic.
"""

from collections.abc import Mapping
from importlib import import_module
from pathlib import Path

from study.common.errors import BadInput, StudyError, explain, nearest
from study.common.files import sha256
from study.data.readers.table import Table

ENDINGS = {
    ".csv": "csv",
    ".parquet": "parquet",
    ".pq": "parquet",
    ".hdf5": "minari",
    ".ulg": "ulog",
    ".bag": "ros",
    ".db3": "ros",
    ".mcap": "ros",
}
"""Formats by the ending of a file. A folder is a LeRobot or Minari data set, or a ROS 2 bag."""


def format_of(path: Path) -> str:
    """The format of a file or folder by its name.

    Raises:
        BadInput: the format is unknown.
    """
    if path.is_dir():
        if (path / "meta" / "info.json").is_file():
            return "lerobot"
        if (path / "data" / "main_data.hdf5").is_file():
            return "minari"
        if (path / "metadata.yaml").is_file():
            return "ros"
        raise BadInput(
            f"{path}: the folder is no LeRobot or Minari data set and no ROS 2 bag; give the logs "
            f"in it, such as '{path / '*.csv'}'"
        )
    if path.suffix.lower() in ENDINGS:
        return ENDINGS[path.suffix.lower()]
    raise BadInput(
        f"{path}: unknown ending '{path.suffix}'; {nearest(path.suffix, ENDINGS)}; a configuration "
        "can name the `format`"
    )


def read(path: Path, file_format: str | None = None) -> list[Table]:
    """The tables of a log.

    Args:
        path: a file, or a folder for formats that are folders.
        file_format: its format; None is by the name.

    Raises:
        BadInput: the log cannot be read, or has no rows.
        StudyError: the package that reads the format is not installed.
    """
    name = file_format or format_of(path)
    try:
        tables: list[Table] = import_module(f"study.data.readers.{name}").read(path)
    except StudyError:
        raise
    except ImportError as error:
        package, extra = EXTRAS.get(name, (name, name))
        raise StudyError(
            f"{path}: reading it needs {package} ({error}): pip install -e '.[{extra}]'"
        ) from None
    except OSError as error:
        raise BadInput(f"{path}: cannot be read as {name}: {explain(error)}") from None
    except Exception as error:  # a package raises what it likes about a damaged file
        reason = " ".join(f"{type(error).__name__}: {error}".split())[:200]
        raise BadInput(f"{path}: cannot be read as {name}, it may be truncated: {reason}") from None
    tables = [table for table in tables if len(table)]
    if not tables:
        raise BadInput(f"{path}: it has no rows")
    return tables


EXTRAS: Mapping[str, tuple[str, str]] = {
    "ulog": ("pyulog", "ulog"),
    "ros": ("rosbags", "ros"),
    "minari": ("h5py", "minari"),
}
"""Package and extra of each format that needs one."""


def files_of(patterns: tuple[str, ...], subject: str) -> list[Path]:
    """The files and folders of some paths or patterns, sorted, each once.

    Raises:
        BadInput: a pattern matches nothing.
    """
    found: dict[Path, None] = {}
    for pattern in patterns:
        path = Path(pattern).expanduser()
        if path.exists():
            found.setdefault(path)
            continue
        anchor = Path(path.anchor) if path.is_absolute() else Path()
        relative = path.relative_to(anchor) if path.is_absolute() else path
        matches = sorted(anchor.glob(str(relative)))
        if not matches:
            raise BadInput(
                f"{subject}: got '{pattern}'; no file matches in the folder '{Path.cwd()}'"
            )
        found |= dict.fromkeys(matches)
    return list(found)


def digests(paths: list[Path]) -> dict[str, str]:
    """The SHA-256 of each log, by its path; of a folder, of all its files.

    Raises:
        BadInput: two logs have the same content, or a file cannot be read.
    """
    found: dict[str, str] = {}
    first: dict[str, Path] = {}
    for path in paths:
        files = sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else [path]
        try:
            digest = "-".join(sha256(file) for file in files)
        except OSError as error:
            raise BadInput(f"{path}: cannot be read: {explain(error)}") from None
        if digest in first:
            raise BadInput(
                f"{path}: it has the same content as {first[digest]}; leave one of them out, since "
                "copies could be in the training set and in the test set"
            )
        first[digest] = path
        found[str(path)] = digest
    return found
