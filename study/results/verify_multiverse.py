"""Check the results folder of a multiverse: its files, and what is made from its effects."""

import tempfile
from collections.abc import Iterator
from pathlib import Path

from paper_figs import specification_curve
from study.common.progress import Progress
from study.multiverse import folder
from study.results import checksums, multiverse
from study.results.folder import STUDY
from study.results.verify import Check, check_files, check_recordings, check_versions, compare_files

REMEDY = "restore it, or write it again: python -m study.run multiverse"


def is_multiverse(out: Path) -> bool:
    """Whether a folder has the results of a multiverse, and none of a study."""
    return not (out / STUDY).is_file() and any((out / name).is_file() for name in folder.FILES)


def verify(out: Path, progress: Progress) -> Iterator[Check]:
    """Run every check.

    Args:
        out: the results folder.
        progress: called with the fraction done.

    Yields:
        the outcome of each check.
    """
    progress(0.0, "checksums")
    problems = checksums.problems(out, multiverse.present(out))
    yield from check_files(out, problems, REMEDY)
    yield check_recordings(out, REMEDY)
    sources = [str(out / name) for name in (*folder.FILES, checksums.NAME)]
    if damaged := [line for line in problems if any(name in line for name in sources)]:
        yield Check("figures", False, f"not made again, since a source is {damaged[0]}")
        return
    with tempfile.TemporaryDirectory(prefix="study-verify-") as temporary:
        repeated = Path(temporary)
        results = folder.read(out)
        folder.write(results, repeated)
        progress(0.1, "tables")
        multiverse.write_pages(results, repeated)
        origin = {"source": "the effects", "remedy": REMEDY}
        yield compare_files("tables", out, repeated, *multiverse.PAGES, **origin)
        progress(0.2, "figures")
        specification_curve.plot(repeated)
        progress(1.0, "figures")
        yield compare_files("figures", out, repeated, "figures/*", **origin)
    yield from check_versions(results.facts["versions"])
