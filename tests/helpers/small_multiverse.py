"""The file of settings of a multiverse that runs in seconds."""

import copy
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from tests.helpers.multiverse import FORECAST

SETTINGS: dict[str, Any] = {
    "name": "small",
    "grid": {
        "environments": ["pusher"],
        "levels": ["low"],
        "models": ["residual_vae", "full_vae", "probabilistic_mlp"],
    },
    "collect": {"trajectories": 12, "validation": 4, "scenarios": 4, "rollouts": 4, "horizon": 6},
    "ensemble": {"members": 2, "hidden_size": 4, "steps": 2, "batch_size": 4},
    "tune": {"trials": 1, "steps": 2, "evaluations": 1, "validation": 2, "samples": 2},
    "vae": {"hidden_size": 4, "latent_size": 2},
    "mlp": {"hidden_size": 4, "layers": 1},
    "train": {"steps": 2, "batch_size": 4, "validate_every": 1},
    "evaluate": {"samples": 4, "examples": 1},
    "engine": {"kind": "serial"},
}
DESIGN: dict[str, Any] = {
    "bases": {"study": {}, "as_written": {"forecast": "mean"}},
    "choices": {
        "forecast": FORECAST,
        "loss": {
            "question": "By which loss is the MLP trained?",
            "values": {"beta": {"mlp.loss": "beta_nll"}, "plain": {"mlp.loss": "nll"}},
        },
    },
}


def written_design(
    folder: Path, further_seeds: Sequence[int] = (), **choices: Mapping[str, Any]
) -> Path:
    """A file of settings with the design, with some of its choices replaced."""
    part = {**copy.deepcopy(DESIGN), "further_seeds": list(further_seeds)}
    part["choices"] |= choices
    path = folder / "small.yaml"
    path.write_text(json.dumps({**SETTINGS, "multiverse": part}), encoding="utf-8")
    return path
