"""Run every benchmark, each in a process of its own: ``python -m tests.benchmarks``.

It takes about 15 minutes on two cores. Nothing else should run at the same time.
"""

import subprocess
import sys
from time import perf_counter

BENCHMARKS = ("simulation", "evaluation", "training", "forecasting", "scale", "logs", "cluster")


def main() -> int:
    """Run them in turn; returns the number of those that failed."""
    failed = 0
    for name in BENCHMARKS:
        print(f"== {name}", flush=True)
        start = perf_counter()
        done = subprocess.run([sys.executable, "-m", f"tests.benchmarks.{name}"], check=False)
        failed += done.returncode != 0
        print(f"== {name}: exit code {done.returncode}, {perf_counter() - start:.0f} s", flush=True)
    return failed


if __name__ == "__main__":
    sys.exit(main())
