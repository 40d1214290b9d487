"""Stage record_data: the Rerun recording of an environment's training data.

Writes ``data.rrd`` with its SHA-256: the first training trajectories of the stage collect.
"""

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from study.common.progress import Progress
from study.common.provenance import made_with, settings_of
from study.config.stage_settings import RecordDataSettings
from study.data.trajectories import Trajectories
from study.envs.observe import system_of
from study.recording.data import record_data

TRAJECTORIES = 20
"""Number of trajectories in the recording."""


def run(
    settings: RecordDataSettings, inputs: Mapping[str, Path], out: Path, progress: Progress
) -> None:
    """Run the stage."""
    trajectories = Trajectories.load(inputs["data"] / "train.safetensors")
    if settings.recorded is None:
        trajectories = trajectories[:TRAJECTORIES]
    else:  # neighbouring windows overlap
        rows = np.linspace(0, len(trajectories) - 1, min(TRAJECTORIES, len(trajectories)))
        trajectories = trajectories[rows.round().astype(np.int64)]
    step = trajectories.facts["control_step"]
    simulator = system_of(settings.environment, settings.recorded, trajectories.horizon, step)
    properties = {
        "environment": settings.environment,
        "seed": str(trajectories.facts["seed"]),
        **made_with(),
        "config": json.dumps({"data": settings_of(inputs["data"])}, sort_keys=True),
        "versions": json.dumps(trajectories.facts["versions"], sort_keys=True),
    }
    progress(0.2, "training data")
    record_data(out / "data.rrd", simulator, trajectories, properties)
