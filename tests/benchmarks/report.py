"""The file that a benchmark leaves in ``tests/benchmarks/results/``.

`paper_figs.pages` writes the tables of ``tests/benchmarks/README.md`` from these files.
"""

import os
import platform
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from study.common.files import write_json
from study.common.provenance import versions

FOLDER = Path(__file__).parent / "results"


def save(name: str, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write ``NAME.json``: the rows of a benchmark, the machine, and the versions of packages."""
    machine = {"processor": processor(), "cores": os.cpu_count(), "system": platform.system()}
    write_json(FOLDER / f"{name}.json", {"machine": machine, "versions": versions(), "rows": rows})


def processor() -> str:
    """The processor's name, and its widest vector instructions where the system tells them."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    facts = dict(line.split("\t: ", 1) for line in lines if "\t: " in line)
    facts = {name.strip(): value for name, value in facts.items()}
    flags = facts.get("flags", "").split()
    width = "AVX-512" if "avx512f" in flags else "AVX2" if "avx2" in flags else ""
    return ", ".join(filter(None, (facts.get("model name", platform.machine()), width)))
