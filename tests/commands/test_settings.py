"""Settings from files and flags."""

from pathlib import Path

import pytest

from study.commands.parser import parse
from study.commands.settings import CONFIGS, change
from study.common.errors import BadInput
from study.config.names import BEYOND, MODELS
from study.config.settings import Config
from tests.helpers.running import configuration


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("tune: {trialz: 3}", "unknown setting 'tune.trialz'"),
        ("tunes: {trials: 3}", "did you mean 'tune'?"),
        ("tune: 3", "it must be a section"),
        ("tune: [3\nx: {", "is not YAML"),
        ("- a\n- b", "holds no settings"),
        ("", "holds no settings"),
        ("tune: {trials: many}", "tune.trials: got 'many'; it must be a whole number"),
        ("\x00\x01", "is not YAML"),
    ],
)
def test_bad_files(text: str, expected: str, tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(text)
    with pytest.raises(BadInput, match=r"^[^\n]*$") as error:
        configuration("--config", str(path))
    assert expected in str(error.value)


def test_flags_and_files_set_the_same_settings(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text("name: mine\ntune: {trials: 7}\ngrid: {seeds: [0, 1]}\n")
    arguments = ["all", "--config", str(path)]
    _, options = parse([*arguments, "--tune.beta_low=1e-3", "--out", "somewhere"])
    assert options.config.tune.trials == 7
    assert options.config.tune.beta_low == 1e-3
    assert options.config.grid.seeds == (0, 1)
    assert options.out == Path("somewhere")
    assert parse(arguments)[1].out == Path("results/mine")


@pytest.mark.parametrize(
    ("given", "models"),
    [
        (["--grid.models", "paper"], MODELS),
        (["--grid.models=all"], (*MODELS, *BEYOND)),
        (["--grid.models", "[all]"], (*MODELS, *BEYOND)),
        (["--grid.models", "[full_crps, paper]"], ("full_crps", *MODELS)),
        (["--grid.models", "[full_vae]"], ("full_vae",)),
    ],
)
def test_groups_of_models(given: list[str], models: tuple[str, ...]) -> None:
    assert configuration(*given).grid.models == models


def test_the_shipped_configs_are_valid() -> None:
    names = {configuration("--config", str(path)).name for path in CONFIGS.glob("*.yaml")}
    assert names == {"smoke", "quick", "paper", "ablations", "ablations_high", "ablations_crps"}


def test_the_default_config_is_quick() -> None:
    assert configuration() == Config()


def test_a_change_leaves_the_other_settings() -> None:
    config = configuration("--vae.hidden_size=7", "--grid.seeds=[1, 2]", "--grid.models=all")
    changed = change(config, ["--vae.latent_size=3", "--collect.horizon", "9"])
    assert changed != config
    assert change(changed, ["--vae.latent_size=8", "--collect.horizon=null"]) == change(
        config, ["--vae.latent_size=8"]
    )
    assert change(config, []) == config


def test_a_change_that_is_not_allowed() -> None:
    with pytest.raises(BadInput, match=r"vae.latent_size: got 0; it must be between 1 and 1000"):
        change(Config(), ["--vae.latent_size=0"])
    with pytest.raises(BadInput, match=r"did you mean 'vae.latent_size'\?"):
        change(Config(), ["--vae.latent_sise=2"])
