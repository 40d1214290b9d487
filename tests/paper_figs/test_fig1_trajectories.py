"""The figures that do not come from scores of models: forecasts split, trials, base rates."""

from pathlib import Path

import matplotlib.image
import numpy as np
import pandas as pd
import pytest

from paper_figs import base_rates, beta, fig1_trajectories
from study.common.errors import BadInput, StudyError
from study.data.storage import save_arrays

Picture = np.ndarray


def illustration(path: Path, epistemic: float, members: int = 3) -> None:
    """Straight flights, the members apart by `epistemic`."""
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


def shade(picture: Picture, colour: str) -> int:
    """Pixels near a colour."""
    wanted = np.array([int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)])
    return int((np.abs(picture[..., :3] - wanted).max(-1) < 0.12).sum())


def test_overview_shows_both_parts(tmp_path: Path) -> None:
    folder = tmp_path / "illustrations" / "uav"
    illustration(folder / "low" / "residual_vae" / "seed-0.safetensors", 0.2)
    illustration(folder / "low" / "ensemble" / "seed-0.safetensors", 9.0)  # not this one
    narrow = matplotlib.image.imread(fig1_trajectories.plot(tmp_path)[0])
    illustration(folder / "low" / "residual_vae" / "seed-0.safetensors", 6.0)
    first = fig1_trajectories.plot(tmp_path)
    assert [path.name for path in first] == ["overview_uav.png", "overview_uav.pdf"]
    wide = matplotlib.image.imread(first[0])
    assert shade(wide, fig1_trajectories.EPISTEMIC) > 2 * shade(narrow, fig1_trajectories.EPISTEMIC)
    assert shade(narrow, fig1_trajectories.ALEATORIC) > shade(narrow, fig1_trajectories.EPISTEMIC)
    bytes_ = [path.read_bytes() for path in first]
    assert [path.read_bytes() for path in fig1_trajectories.plot(tmp_path)] == bytes_


def test_overview_of_damaged_or_missing_illustrations(tmp_path: Path) -> None:
    assert fig1_trajectories.plot(tmp_path) == []
    path = tmp_path / "illustrations" / "uav" / "low" / "residual_vae" / "seed-0.safetensors"
    illustration(path, 1.0)
    flipped = bytearray(path.read_bytes())
    flipped[-9] ^= 1
    path.write_bytes(flipped)
    with pytest.raises(StudyError, match="damaged"):
        fig1_trajectories.plot(tmp_path)
    with pytest.raises(BadInput, match="no folder"):
        fig1_trajectories.plot(tmp_path / "elsewhere")


def test_beta_shows_every_search(tmp_path: Path) -> None:
    betas = np.geomspace(0.1, 30, 6)
    trials = pd.concat(
        pd.DataFrame(
            {
                "environment": environment,
                "level": level,
                "model": model,
                "seed": 0,
                "number": range(6),
                "state": ["complete"] * 5 + ["pruned"],
                "beta": betas,
                "value": np.log(betas) ** 2 / 10 + 0.1,
                "chosen": np.arange(6) == 2,
            }
        )
        for environment in ("pusher", "uav")
        for level in ("low", "high")
        for model in ("residual_vae", "full_vae")
    )
    trials.to_parquet(tmp_path / "trials.parquet")
    picture, _ = beta.plot(tmp_path)
    pixels = matplotlib.image.imread(picture)
    assert shade(pixels, "#0072B2") > 300
    assert shade(pixels, "#D55E00") > 300
    trials.iloc[:0].to_parquet(tmp_path / "trials.parquet")
    assert beta.plot(tmp_path) == []
    with pytest.raises(BadInput, match=r"no trials\.parquet"):
        beta.plot(tmp_path / "elsewhere")


def test_base_rates_are_those_of_the_scenarios(tmp_path: Path) -> None:
    probability = np.repeat([0.0, 0.3, 0.5, 0.95], [5, 20, 10, 5])
    rows = pd.DataFrame(
        {
            "environment": "uav",
            "level": "low",
            "model": "oracle",
            "seed": 0,
            "metric": "observed_probability",
            "dimension": "all",
            "step": -1,
            "scenario": range(40),
            "value": probability,
        }
    )
    pd.concat([rows, rows.assign(model="full_vae")]).to_parquet(tmp_path / "scores.parquet")
    picture, _ = base_rates.plot(tmp_path)
    pixels = matplotlib.image.imread(picture)
    middle, ends = shade(pixels, base_rates.MIDDLE), shade(pixels, base_rates.ENDS)
    assert middle / ends == pytest.approx(30 / 10, rel=0.35)
