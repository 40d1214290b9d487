"""Tables of a page: what a reader sees, by what a column sorts, and the file to download."""

import csv
import io
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any
from urllib.parse import quote

from paper_figs.formatting import number
from study.metrics.intervals import Interval


@dataclass(frozen=True)
class Value:
    """One entry of a table.

    Attributes:
        text: what is shown.
        detail: a smaller line below it, such as an interval.
        trace: where a number comes from: cell, metric, n and interval; empty for other entries.
        order: by what the column is sorted; None for the text.
        kind: class of the style sheet: "number", "best", "verdict" or "".
        links: addresses within the folder, by text.
    """

    text: str
    detail: str = ""
    trace: str = ""
    order: float | None = None
    kind: str = ""
    links: Sequence[tuple[str, str]] = ()

    @property
    def plain(self) -> str:
        """The entry in a file: its text, or the texts of its links."""
        return self.text or ", ".join(name for name, _ in self.links)


@dataclass(frozen=True)
class Table:
    """A table.

    Attributes:
        id: unique in the page.
        caption: what it shows.
        heads: titles of the columns.
        rows: entries; the first of a row is its head.
        download: the rows of the CSV file, the first with the titles of its columns.
        notes: sentences below the table.
        tools: whether the table can be sorted and filtered.
    """

    id: str
    caption: str
    heads: Sequence[str]
    rows: Sequence[Sequence[Value]]
    download: Sequence[Sequence[Any]] = ()
    notes: Sequence[str] = field(default_factory=tuple)
    tools: bool = False

    @property
    def csv(self) -> str:
        """The CSV file as an address that needs no server."""
        stream = io.StringIO()
        csv.writer(stream, lineterminator="\n").writerows(
            [_plain(entry) for entry in row] for row in self._download_rows
        )
        return f"data:text/csv;charset=utf-8,{quote(stream.getvalue())}"

    @property
    def _download_rows(self) -> Iterable[Sequence[Any]]:
        return self.download or [self.heads, *([v.plain for v in row] for row in self.rows)]


def text(value: object, **attributes: Any) -> Value:
    """An entry of plain text; a dash for None."""
    return Value("—" if value is None else str(value), **attributes)


def figure(value: float | None, trace: str = "", digits: int = 3, kind: str = "") -> Value:
    """A number without an interval."""
    is_count = digits == 0 and value is not None and math.isfinite(value)
    shown = f"{value:,.0f}" if is_count else number(value, digits)
    return Value(shown, trace=trace, order=value, kind=f"number {kind}".strip())


def estimate(found: Interval, trace: str, digits: int = 3, kind: str = "") -> Value:
    """A number with its interval."""
    return Value(
        number(found.estimate, digits),
        f"[{number(found.low, digits)}, {number(found.high, digits)}]",
        f"{trace}\n{number(found.estimate, 6)}, 95 % interval "
        f"[{number(found.low, 6)}, {number(found.high, 6)}]\n"
        f"n = {found.scenarios} scenarios × {found.seeds} seed{'' if found.seeds == 1 else 's'}",
        found.estimate,
        f"number {kind}".strip(),
    )


def _plain(entry: Any) -> Any:
    """An entry for a spreadsheet. Text that a spreadsheet would run as a formula gets a quote."""
    if isinstance(entry, str) and entry[:1] in ("=", "+", "-", "@", "\t"):
        return f"'{entry}"
    return "" if entry is None else entry
