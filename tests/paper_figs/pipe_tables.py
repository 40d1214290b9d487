"""Read the tables of pages."""


def pipe_cells(table: str) -> dict[tuple[str, str], str]:
    """The entries of a pipe table, by row and column."""
    heads, _, *rows = (
        [cell.strip() for cell in line.split("|")[1:-1]]
        for line in table.splitlines()
        if line.startswith("|")
    )
    return {
        (row[0], head): cell for row in rows for head, cell in zip(heads[1:], row[1:], strict=True)
    }
