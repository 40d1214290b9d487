"""100,000 windows of 120 steps and 20 columns, from logs: ``python -m tests.benchmarks.logs``.

Processor seconds of one core, and peak memory beyond that of the program itself, of the stage
collect: it reads the logs, checks every row, splits the trajectories, and writes the data sets.
Each case runs in a process of its own. The second case needs 3 GB of disk.
"""

import multiprocessing
import os
import tempfile
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from study.common.progress import Progress
from study.config.recorded import Recorded
from study.config.settings import Collect
from study.config.stage_settings import CollectSettings
from study.data.trajectories import ScenarioSet, Trajectories
from study.stages import collect
from tests.benchmarks.costs import Cost, cost_of

WINDOWS, HORIZON, STATES, ACTIONS = 100_000, 120, 16, 4
FILES = 100
STEP = 0.02
MOST_SECONDS, MOST_MEMORY = 60.0, 2e9
"""What `study/data/README.md` promises."""


@dataclass(frozen=True)
class Case:
    """One form of the logs.

    Attributes:
        title: for the table.
        suffix: of the files.
        stride: steps from one window to the next.
    """

    title: str
    suffix: str
    stride: int

    @property
    def rows(self) -> int:
        """Rows of each file, so that all files have `WINDOWS` windows."""
        return HORIZON + 1 + self.stride * (WINDOWS // FILES - 1)


CASES = (
    Case("CSV, overlapping windows", ".csv", 10),
    Case("Parquet, no overlap", ".parquet", HORIZON),
)


def write_logs(folder: Path, case: Case) -> None:
    """Write random logs of numbers with seven digits, as loggers write them."""
    names = [*(f"s{i}" for i in range(STATES)), *(f"a{i}" for i in range(ACTIONS))]
    for number in range(FILES):
        values = np.random.default_rng(number).normal(size=(case.rows, len(names)))
        frame = pd.DataFrame(values.astype(np.float32), columns=names)
        frame.insert(0, "time", STEP * np.arange(case.rows))
        path = folder / f"{number:03}{case.suffix}"
        if case.suffix == ".csv":
            frame.to_csv(path, index=False, float_format="%.7g")
        else:
            frame.to_parquet(path)


def measure(folder: Path, case: Case) -> Cost:
    """The cost of the stage collect for the logs in a folder."""
    recorded = Recorded(
        files=(str(folder / f"*{case.suffix}"),),
        state=tuple(f"s{i}" for i in range(STATES)),
        action=tuple(f"a{i}" for i in range(ACTIONS)),
        time="time",
        horizon=HORIZON,
        stride=case.stride,
        test_stride=case.stride,
    )
    sizes = Collect(validation=WINDOWS, scenarios=WINDOWS)
    settings = CollectSettings("robot", sizes, recorded)
    out = folder / "out"
    out.mkdir()
    cost = cost_of(lambda: collect.run(settings, {}, out, Progress()))
    count = len(Trajectories.load(out / "train.safetensors"))
    count += sum(len(ScenarioSet.load(out / f"{s}.safetensors")) for s in ("validation", "test"))
    assert count == WINDOWS, count
    return cost


def main() -> None:
    """Measure and print."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["tests.benchmarks.costs"])
    os.environ["OMP_NUM_THREADS"] = "1"
    print(f"{WINDOWS:,} windows of {HORIZON} steps and {STATES + ACTIONS} columns", flush=True)
    for case in CASES:
        with tempfile.TemporaryDirectory() as name:
            write_logs(Path(name), case)
            with ProcessPoolExecutor(1, mp_context=context) as pool:
                cost = pool.submit(measure, Path(name), case).result()
        is_within = cost.seconds < MOST_SECONDS and cost.memory < MOST_MEMORY
        print(
            f"  {case.title}, {FILES * case.rows:,} rows: {cost.seconds:.0f} s, "
            f"{cost.memory / 1e9:.2f} GB{'' if is_within else '  more than is promised'}",
            flush=True,
        )


if __name__ == "__main__":
    main()
