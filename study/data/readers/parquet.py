"""Parquet files. Messages count rows from 0."""

from pathlib import Path

import pandas as pd

from study.data.readers.csv import table_of
from study.data.readers.table import Table


def read(path: Path) -> list[Table]:
    """One table with all columns."""
    return [table_of(pd.read_parquet(path), 0)]
