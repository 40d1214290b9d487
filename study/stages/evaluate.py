"""Stage evaluate: forecast the test scenarios and score the forecasts.

Every forecaster, the simulator included, goes through the same lines. Writes ``scores.parquet``
(tidy, see `study.metrics.scores`) and ``examples.safetensors``: the forecasts of a few scenarios,
chosen by stated rules, for the recordings; and, of a forecaster with an ensemble,
``illustration.safetensors``: the positions and variances that Fig. 1 of the paper shows.
"""

from pathlib import Path
from typing import Any

import numpy as np

from study.common.progress import Progress
from study.common.seeds import spawn
from study.data.kernel import Kernel
from study.data.storage import save_arrays
from study.data.trajectories import ScenarioSet
from study.envs import simulators
from study.metrics.tables.scores import Outcomes, score
from study.models.forecasting import forecast_in_parts, load_forecaster, members_of, picked
from study.models.oracle import Oracle
from study.recording.examples import choose_examples, illustrate


def run(settings: dict[str, Any], inputs: dict[str, Path], out: Path, progress: Progress) -> None:
    """See the module."""
    evaluate, samples = settings["evaluate"], settings["evaluate"]["samples"]
    test = ScenarioSet.load(inputs["data"] / "test.safetensors")
    simulator = simulators[settings["environment"]](horizon=test.actions.shape[1])
    forecaster = load_forecaster(settings["model"], simulator, inputs)
    kernel = Kernel.load(inputs["data"])
    seeds = spawn(settings["seed"], len(test))
    progress(0.01, "forecasting")
    forecasts = forecast_in_parts(forecaster, test, samples, seeds, progress.part(0.01, 0.5))
    member = members_of(forecaster, seeds, samples)
    scores = score(
        forecasts,
        test.observed,
        Outcomes(
            simulator.outcomes(forecasts, test.goal[:, None]),
            simulator.outcomes(test.observed, test.goal[:, None]),
            simulator.reached(forecasts, test.goal[:, None]),
            simulator.reached(test.observed, test.goal[:, None]),
        ),
        kernel.scale,
        kernel.bandwidth * evaluate["bandwidth"],
        kernel.names,
        member,
        ruler=isinstance(forecaster, Oracle),
        progress=lambda share: progress.part(0.5, 1.0)(share, "scoring"),
    )
    scores.to_parquet(out / "scores.parquet", index=False)
    chosen = choose_examples(scores, evaluate["examples"])
    arrays = picked(forecaster, test, forecasts, seeds, np.array(list(chosen.values())))
    save_arrays(out / "examples.safetensors", arrays, {"rules": list(chosen)})
    if "members" in arrays:
        illustration, facts = illustrate(simulator, arrays, list(chosen))
        save_arrays(out / "illustration.safetensors", illustration, facts)
