"""Fig. 1: both parts of the uncertainty are visible; damaged and missing illustrations."""

from pathlib import Path

import numpy as np
import pytest

from paper_figs import fig1_trajectories
from study.common.errors import BadInput, StudyError
from study.data.storage import save_arrays
from tests.paper_figs.pictures import pixels_of

RESIDUAL = Path("illustrations", "uav", "low", "residual_vae", "seed-0.safetensors")
ENSEMBLE = Path("illustrations", "uav", "low", "ensemble", "seed-0.safetensors")


def write_illustration(path: Path, epistemic: float, members: int = 3) -> None:
    """Straight flights on parallel lanes, one for each member, `epistemic` metres apart."""
    generator = np.random.default_rng(0)
    member = generator.integers(members, size=30)
    time = np.linspace(0, 1, 11)[:, None]
    lanes = epistemic * np.stack([np.zeros(members), np.arange(members), np.zeros(members)], 1)
    heading = np.array([10.0, 0.0, 0.0])
    noise = generator.normal(size=(30, 1, 3))
    arrays = {
        "observed": time * (heading + noise),
        "members": time * (heading + lanes[:, None]),
        "forecast": time * (heading + lanes[member][:, None] + noise),
        "member": member,
        "target": heading,
        "aleatoric": 3 * time[1:, 0] ** 2,
        "epistemic": (epistemic * time[1:, 0]) ** 2,
        "observed_variance": 3 * time[1:, 0] ** 2,
    }
    facts = {"rule": "one", "scenario": 4, "radius": 1.0, "control_step": 0.4, "samples": 30}
    save_arrays(path, {k: np.asarray(v) for k, v in arrays.items()}, facts)


def pixels(path: Path, colour: str) -> int:
    return pixels_of(path, colour, 0.12)


def test_the_epistemic_part_grows_with_the_distance_of_members(tmp_path: Path) -> None:
    write_illustration(tmp_path / RESIDUAL, 0.2)
    write_illustration(tmp_path / ENSEMBLE, 9.0)  # the residual VAE is preferred
    small = fig1_trajectories.plot(tmp_path)[0]
    few = pixels(small, fig1_trajectories.EPISTEMIC)
    assert pixels(small, fig1_trajectories.ALEATORIC) > few
    write_illustration(tmp_path / RESIDUAL, 6.0)
    large = fig1_trajectories.plot(tmp_path)[0]
    assert pixels(large, fig1_trajectories.EPISTEMIC) > 2 * few


def test_the_same_illustrations_give_the_same_bytes(tmp_path: Path) -> None:
    write_illustration(tmp_path / RESIDUAL, 1.0)
    paths = fig1_trajectories.plot(tmp_path)
    assert [path.name for path in paths] == ["overview_uav.png", "overview_uav.pdf"]
    first = [path.read_bytes() for path in paths]
    assert [path.read_bytes() for path in fig1_trajectories.plot(tmp_path)] == first


def test_damaged_and_missing_illustrations(tmp_path: Path) -> None:
    assert fig1_trajectories.plot(tmp_path) == []
    path = tmp_path / RESIDUAL
    write_illustration(path, 1.0)
    flipped = bytearray(path.read_bytes())
    flipped[-9] ^= 1
    path.write_bytes(flipped)
    with pytest.raises(StudyError, match="damaged"):
        fig1_trajectories.plot(tmp_path)
    with pytest.raises(BadInput, match="no folder"):
        fig1_trajectories.plot(tmp_path / "elsewhere")
