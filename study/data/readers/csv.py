"""CSV files with a header line. Messages count lines: the header is line 1."""

from pathlib import Path

import pandas as pd

from study.common.errors import BadInput
from study.data.readers.table import Table

FIRST_LINE = 2


def read(path: Path) -> list[Table]:
    """One table with all columns."""
    try:
        frame = pd.read_csv(path, skipinitialspace=True)
    except pd.errors.EmptyDataError:
        raise BadInput(f"{path}: the file is empty") from None
    return [table_of(frame, FIRST_LINE)]


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
