"""Write the tables in the repository's pages from the committed numbers.

python -m paper_figs.pages            # rewrite every page that differs
python -m paper_figs.pages --check    # name the pages that differ; exit code 1 if there are any
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from paper_figs.pages import (
    benchmark_tables,
    claim_tables,
    multiverse_tables,
    posterior_tables,
    study_tables,
)
from paper_figs.pages.marks import pages, rewritten
from study.common.errors import StudyError

ROOT = Path(__file__).resolve().parents[2]


def outdated(root: Path = ROOT) -> dict[Path, str]:
    """The pages whose tables differ from the committed numbers, with the text they should have.

    Raises:
        BadInput: a mark in a page cannot be used, or the numbers cannot be read.
    """
    results = root / "results"
    tables = (
        study_tables.tables(results)
        | claim_tables.tables(results)
        | multiverse_tables.tables(results)
        | posterior_tables.tables(results)
        | benchmark_tables.tables(root)
    )
    texts = {page: page.read_text(encoding="utf-8") for page in pages(root)}
    expected = {page: rewritten(text, tables) for page, text in texts.items()}
    return {page: text for page, text in expected.items() if text != texts[page]}


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--check", action="store_true", help="write nothing; exit code 1 if needed")
    check = parser.parse_args(arguments).check
    try:
        differing = outdated()
    except StudyError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code
    for page, text in differing.items():
        print(page.relative_to(ROOT))
        if not check:
            page.write_text(text, encoding="utf-8")
    return int(check and bool(differing))


if __name__ == "__main__":
    sys.exit(main())
