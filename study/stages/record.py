"""Stage record: the cell's Rerun recordings, from what the earlier stages left.

Writes ``forecast.rrd`` and ``scores.rrd``, and where the cell has them ``training.rrd`` and
``tuning.rrd``, each with its SHA-256.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from study.common.files import copy, read_json
from study.common.progress import Progress
from study.common.provenance import made_with
from study.config.grid import Cell
from study.data.storage import Arrays, load_arrays
from study.data.trajectories import Floats
from study.envs import simulators
from study.envs.simulator import Simulator
from study.metrics.variance import Decomposition, decompose
from study.recording.forecasts import Pick, record_forecast
from study.recording.integrity import checksum_path
from study.recording.properties import Properties
from study.recording.scores import record_scores
from study.recording.tuning import record_tuning
from study.workflow.store import MANIFEST


def run(settings: dict[str, Any], inputs: dict[str, Path], out: Path, progress: Progress) -> None:
    """See the module."""
    cell = Cell(*(settings[name] for name in ("environment", "level", "model", "seed")))
    properties = _properties(cell, inputs)
    for source in ("trained", "ensemble"):
        if source in inputs:
            recording = inputs[source] / "training.rrd"
            copy(recording, out / recording.name)
            copy(checksum_path(recording), checksum_path(out / recording.name))
            break
    if "tuning" in inputs:
        tuning = read_json(inputs["tuning"] / "tuning.json")
        record_tuning(out / "tuning.rrd", _trials(tuning["trials"]), properties)
    progress(0.2, "scores")
    scores = pd.read_parquet(inputs["evaluation"] / "scores.parquet")
    record_scores(out / "scores.rrd", scores, properties)
    progress(0.5, "forecasts")
    simulator = simulators[cell.environment]()
    picks = read_picks(inputs["evaluation"] / "picks.safetensors", scores, simulator)
    record_forecast(out / "forecast.rrd", simulator, picks, properties)


def _properties(cell: Cell, inputs: dict[str, Path]) -> Properties:
    """What the recordings say of where they come from."""
    settings = {name: read_json(folder / MANIFEST)["settings"] for name, folder in inputs.items()}
    return {
        "cell": cell.name,
        "environment": cell.environment,
        "level": cell.level,
        "model": cell.model,
        "seed": cell.seed,
        **made_with(),
        "config": json.dumps(settings, sort_keys=True),
    }


def _trials(trials: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """JSON has no integer keys."""
    return [
        trial | {"intermediate": {int(k): v for k, v in trial["intermediate"].items()}}
        for trial in trials
    ]


def read_picks(path: Path, scores: pd.DataFrame, simulator: Simulator) -> list[Pick]:
    """What stage evaluate picked; with an ensemble, the variance of the position in its parts."""
    arrays, facts = load_arrays(path)
    discrepancy = scores[
        (scores.metric == "mmd2") & (scores.step == -1) & (scores.dimension == "all")
    ].set_index("scenario")["value"]
    return [
        as_pick(
            arrays,
            row,
            simulator,
            int(scenario),
            f"{rule}: MMD² {discrepancy[scenario]:.4f} in scenario {scenario}",
        )
        for row, (scenario, rule) in enumerate(zip(arrays["scenario"], facts["rules"], strict=True))
    ]


def as_pick(
    arrays: Arrays, row: int, simulator: Simulator, scenario: int | None, rule: str
) -> Pick:
    """One row of what stage evaluate keeps of its picks; with an ensemble, the spread in parts."""
    each = ("s0", "actions", "task", "observed", "forecast", "member", "members")
    of_pick = {name: arrays[name][row] for name in each if name in arrays}
    if "member" in of_pick:
        parts = position_variance(simulator, of_pick["forecast"], of_pick["member"])
        of_pick |= {"aleatoric": parts.aleatoric, "epistemic": parts.epistemic}
    return Pick(scenario=scenario, rule=rule, **of_pick)


def position_variance(
    simulator: Simulator, states: Floats, member: NDArray[np.int64] | None = None
) -> Decomposition:
    """Variance of the position over the horizon [T] in m², summed over its axes, and its parts.

    Unbiased: of few samples a member, the members' means differ by chance too.

    Args:
        simulator: knows the position.
        states: [K, T, D].
        member: [K], the ensemble member behind each; None without an ensemble.
    """
    parts = decompose(simulator.position(states)[None], None if member is None else member[None])
    return Decomposition(*(part.sum(axis=-1) for part in vars(parts).values()))
