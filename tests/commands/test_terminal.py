"""Tables in narrow terminals."""

import io

import pytest
from rich.box import SIMPLE
from rich.console import Console
from rich.table import Table

from study.commands.terminal import show

ROWS = (
    ("pusher/low/residual_vae_ensemble/seed-0", "0.034", "0.1234", "0.222", "0.213"),
    ("uav/high/full_vae/seed-11", "12", "10.4321", "0.111", ""),
)


@pytest.mark.parametrize("width", [10, 25, 40, 60, 80, 200])
def test_a_narrow_terminal_keeps_every_number(width: int) -> None:
    output = io.StringIO()
    table = Table(title="scores", box=SIMPLE, pad_edge=False, padding=(0, 1, 0, 0))
    for column in ("cell", "β", "MMD²", "Brier", "oracle"):
        table.add_column(column, justify="left" if column == "cell" else "right")
    for row in ROWS:
        table.add_row(*row)
    show(Console(file=output, width=width), table)
    words = output.getvalue().split()
    numbers = [value for row in ROWS for value in row[1:] if value]
    assert [word for word in words if word in numbers] == numbers
    assert {"β", "MMD²", "Brier", "oracle"} <= set(words)
    assert "…" not in output.getvalue()
    if width >= 60:
        assert all(len(line) <= width for line in output.getvalue().splitlines())
