"""What the recording costs training: ``python -m tests.benchmarks.recording_cost``.

The same fit with and without the `RerunLogger`, in turn: a model of quick size on trajectories of
the Pusher, trained by the same `fit` as in the study, with a look at the validation data. All that
the logger does is counted, its start and the finished file among it; what Rerun does on threads of
its own shows on the clock alone.
"""

import argparse
import logging
import tempfile
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from lightning.pytorch.loggers import Logger

from study.common.progress import Progress
from study.data.normalization import Normalization
from study.data.trajectories import ScenarioSet
from study.recording.training import RerunLogger
from study.training.data_module import TrajectoryDataModule
from study.training.fit import fit
from tests.benchmarks.sizes import SIZES, built, observe
from tests.benchmarks.timing import as_a_worker, interleave, times_as_fast

MOST = 0.03
"""By so much of its time training may be slower."""
TRAJECTORIES, VALIDATION, BATCH = 192, 8, 64


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=100)
    parser.add_argument("--repeats", type=int, default=7)
    given: Any = parser.parse_args()
    as_a_worker()
    warnings.filterwarnings("ignore")
    logging.getLogger("lightning.pytorch").setLevel(logging.ERROR)
    data = observe("pusher", TRAJECTORIES)
    few = data[:VALIDATION]
    validation = ScenarioSet(
        s0=few.states[:, 0],
        actions=few.actions,
        goal=few.goal,
        observed=few.states[:, None, 1:],
        unobserved=few.unobserved[:, None],
        facts={},
    )
    for name in ("full_vae", "probabilistic_mlp"):

        def train(loggers: Sequence[Logger], folder: Path, name: str = name) -> None:
            model = built(name, SIZES["quick"], data)
            model.validation_score = lambda forecasts, observed: float(np.var(forecasts))
            normalization = Normalization.of(data)
            module = TrajectoryDataModule(
                normalization, data[VALIDATION:], validation, BATCH, seed=0
            )
            fit(
                model,
                module,
                folder,
                Progress(),
                seed=0,
                steps=given.steps,
                validate_every=given.steps // 2,
                patience=None,
                accelerator="cpu",
                loggers=loggers,
            )

        def without() -> None:
            with tempfile.TemporaryDirectory() as folder:
                train([], Path(folder))

        def recorded() -> None:
            with (
                tempfile.TemporaryDirectory() as folder,
                RerunLogger(Path(folder) / "training.rrd") as logger,
            ):
                train([logger], Path(folder))

        timings = interleave({"without": without, "with": recorded}, given.repeats)
        for label, timing in timings.items():
            clock = float(np.median(timing.clock))
            print(f"{name:18} {label:8} {timing.median():7.2f} s  {clock:7.2f} s by the clock")
        ratio, least, most = times_as_fast(timings["without"], timings["with"])
        print(f"{name:18} with / without {ratio:.3f} ({least:.3f} to {most:.3f})", end="")
        print(f", at most {1 + MOST}: {'yes' if ratio <= 1 + MOST else 'no'}", end="")
        clocks = np.divide(timings["with"].clock, timings["without"].clock)
        print(f"; by the clock {np.median(clocks):.3f}", flush=True)


if __name__ == "__main__":
    main()
