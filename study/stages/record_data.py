"""Stage record_data: the Rerun recording of an environment's training data.

Writes ``data.rrd``, with its SHA-256, of the first trajectories that the stage collect observed.
"""

import json
from pathlib import Path
from typing import Any

from study.common.files import read_json
from study.common.progress import Progress
from study.common.provenance import made_with
from study.data.trajectories import Trajectories
from study.envs import simulators
from study.recording.data import record_data
from study.workflow.store import MANIFEST

TRAJECTORIES = 20


def run(settings: dict[str, Any], inputs: dict[str, Path], out: Path, progress: Progress) -> None:
    """See the module."""
    trajectories = Trajectories.load(inputs["data"] / "train.safetensors")[:TRAJECTORIES]
    environment = settings["environment"]
    simulator = simulators[environment](horizon=trajectories.horizon)
    collected = read_json(inputs["data"] / MANIFEST)["settings"]
    properties = {
        "environment": environment,
        "seed": str(trajectories.facts["seed"]),
        **made_with(),
        "config": json.dumps({"data": collected}, sort_keys=True),
        "versions": json.dumps(trajectories.facts["versions"], sort_keys=True),
    }
    progress(0.2, "training data")
    record_data(out / "data.rrd", simulator, trajectories, properties)
