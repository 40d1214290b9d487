"""Generated blocks in Markdown pages. A program writes the text between two marks.

A block begins with the line ``<!-- table: NAME -->`` and ends with the line ``<!-- end -->``.
"""

import re
from collections.abc import Callable, Mapping
from pathlib import Path

from study.common.errors import BadInput, nearest

BLOCK = re.compile(r"^<!-- table: (?P<name>[\w-]+) -->\n(?P<text>.*?)^<!-- end -->$", re.M | re.S)
OPENING = re.compile(r"^<!-- table:", re.M)


def rewritten(page: str, tables: Mapping[str, Callable[[], str]]) -> str:
    """The page, with every block generated from the current numbers.

    Args:
        page: the text of a Markdown page.
        tables: the function that returns the content of a block, by the name in the block's mark.

    Raises:
        BadInput: a mark names an unknown table, or its block has no end.
    """

    def block(match: re.Match[str]) -> str:
        name = match["name"]
        if name not in tables:
            raise BadInput(f"unknown table '{name}': {nearest(name, tables)}")
        return f"<!-- table: {name} -->\n{tables[name]().strip()}\n<!-- end -->"

    blocks = BLOCK.findall(page)
    if len(blocks) != len(OPENING.findall(page)) or any(OPENING.search(t) for _, t in blocks):
        raise BadInput("a table has no '<!-- end -->': write it on a line after the table")
    return BLOCK.sub(block, page)


def pages(root: Path) -> list[Path]:
    """The pages of the repository that may have generated blocks."""
    patterns = ("README.md", "results/paper/README.md", "study/**/README.md", "tests/**/README.md")
    return sorted(path for pattern in patterns for path in root.glob(pattern))


def pipe_table(heads: list[str], rows: list[list[str]], align: str = "---:") -> str:
    """A Markdown table.

    Args:
        heads: the header.
        rows: the cells of each row.
        align: the rule of the columns after the first; aligned to the right by default.
    """
    lines = [heads, ["---", *[align] * (len(heads) - 1)], *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)
