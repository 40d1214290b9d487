"""CSV files with a header line. Messages count lines: the header is line 1."""

import csv
from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from study.common.errors import BadInput
from study.data.readers.table import Table

FIRST_LINE = 2
SEPARATORS = ",;\t"
"""Characters between values; the one that the header has most often is that of the file."""


def read(path: Path) -> list[Table]:
    """One table with all columns.

    Raises:
        BadInput: the file is empty or no text, two columns have the same name, or a line has more
            values than the header.
    """
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            header, first = file.readline(), file.readline()
        separator = max(SEPARATORS, key=header.count)
        _check_header(path, *csv.reader([header, first], delimiter=separator))
        frame = pd.read_csv(path, sep=separator, skipinitialspace=True)
    except pd.errors.EmptyDataError:
        raise BadInput(f"{path}: the file is empty") from None
    except UnicodeDecodeError as error:
        raise BadInput(f"{path}: it is no UTF-8 text ({error.reason}); save it as UTF-8") from None
    except pd.errors.ParserError as error:
        reason = str(error).rpartition("C error: ")[2].strip()
        raise BadInput(f"{path}: {reason}; every line must have the columns of line 1") from None
    return [table_of(frame, FIRST_LINE)]


def _check_header(path: Path, header: Sequence[str] = (), first: Sequence[str] = ()) -> None:
    """Check what pandas would accept: it renames doubled columns, and shifts rows that are longer.

    Raises:
        BadInput: two columns have the same name, or the first row has more values than names.
    """
    names = [name.strip() for name in header]
    for name in names:
        if names.count(name) > 1:
            raise BadInput(f"{path}: line 1 names {names.count(name)} columns '{name}'; rename one")
    if len(first) > len(names):
        raise BadInput(
            f"{path}: line 2 has {len(first)} values, and line 1 has {len(names)} names; name "
            "every column"
        )


def table_of(frame: pd.DataFrame, first_row: int) -> Table:
    """The table of a data frame; dates and durations become seconds."""
    columns = {}
    for name in frame:
        values = frame[name]
        if pd.api.types.is_datetime64_any_dtype(values):
            values = (values - values.iloc[0]).dt.total_seconds()
        elif pd.api.types.is_timedelta64_dtype(values):
            values = values.dt.total_seconds()
        columns[str(name)] = values.to_numpy()
    return Table(columns, first_row=first_row)
