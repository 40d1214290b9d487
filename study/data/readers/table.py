"""A table of a log: columns that were sampled at the same times."""

from collections.abc import Mapping
from dataclasses import dataclass

from study.common.arrays import Array, Doubles


@dataclass(frozen=True)
class Table:
    """Columns of N rows.

    Attributes:
        columns: by name, [N] numbers or text.
        time: [N] float64, seconds; None if the format has no time.
        trajectory: [N], the trajectory of each row, from the format; None without.
        name: of the topic; empty for a log with one table.
        first_row: number of the first row in messages, such as the line of a CSV file.
    """

    columns: Mapping[str, Array]
    time: Doubles | None = None
    trajectory: Array | None = None
    name: str = ""
    first_row: int = 1

    def __len__(self) -> int:
        return len(next(iter(self.columns.values()))) if self.columns else 0
