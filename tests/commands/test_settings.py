"""Settings from files and flags."""

from pathlib import Path

import pytest

from study.commands.parser import parse
from study.commands.settings import CONFIGS, DEFAULT, change
from study.common.errors import BadInput
from study.common.files import write_json
from study.config.names import BEYOND, MODELS
from study.config.settings import Config
from study.results.folder import FORMAT, settings_of, write_run_settings
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
        ("collect: {trajectories: }", "collect.trajectories: got null; it must be a whole number"),
        ("grid: {seeds: }", "grid.seeds: got null; it must be a list of whole numbers"),
        ("grid: {seeds: [0, ]}\ntune: ", "it must be a section"),
        ("train: {learning_rate: .inf}", "train.learning_rate: got '.inf'; it must be a number"),
        ("tune: {beta_high: 1e400}", "tune.beta_high: got '1e400'; it must be a number"),
        ("tune: {trials: 012}", "tune.trials: got '012'; it must be a whole number"),
        ("tune: {trials: 1:30}", "tune.trials: got '1:30'; it must be a whole number"),
        ("tune: {trials: 3}\ntune: {steps: 9}", "'tune' stands there twice (line 2)"),
        ("name: 2024", "write '2024' with quotes"),
        ("model: {nowhere: {initial_std: 1}}", "plugins lists the modules of your models"),
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


def test_flags_override_the_file_wherever_it_stands(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text("tune: {trials: 7, steps: 9}\n")
    for arguments in (
        ["--tune.trials=3", "--config", str(path)],
        ["--config", str(path), "--tune.trials", "3"],
        ["--tune.trials=5", f"--config={path}", "--tune.trials=3"],
    ):
        tune = configuration(*arguments).tune
        assert (tune.trials, tune.steps) == (3, 9)


def test_levels_from_files_and_flags(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text("grid: {levels: {low: 1.0, tiny: 0.01}}\n")
    levels = {"low": 1.0, "tiny": 0.01}
    assert configuration("--config", str(path)).grid.levels == levels
    assert configuration("--grid.levels={tiny: 0.01, low: 1}").grid.levels == levels
    assert configuration("--grid.levels=[high]").grid.levels == {"high": 0.1}


def test_a_plugins_settings_from_files_flags_and_help(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "mine.yaml"
    text = "plugins: [study.examples.drift]\nmodel: {drift: {initial_std: 0.3}}\n"
    path.write_text(text)
    key = "model.drift"
    assert configuration("--config", str(path)).section(key).initial_std == 0.3
    flags = ["--plugins=[study.examples.drift]", "--model.drift.initial_std=2"]
    assert configuration(*flags).section(key).initial_std == 2.0
    with pytest.raises(SystemExit):
        parse(["all", "--help", flags[0]])
    assert "--model.drift.initial_std" in capsys.readouterr().out
    path.write_text(text.replace("initial_std", "initial_sd"))
    with pytest.raises(BadInput, match=r"did you mean 'model.drift.initial_std'"):
        configuration("--config", str(path))
    with pytest.raises(BadInput, match=r"got 11.0; it must be between 1e-06 and 10.0"):
        configuration(flags[0], "--model.drift.initial_std=11")


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
    # The file of the multiverse has a part for its own command: see tests/commands/test_multiverse.
    files = [path for path in CONFIGS.glob("*.yaml") if path.stem != "multiverse"]
    names = {configuration("--config", str(path)).name for path in files}
    ablations = {"ablations", "ablations_crps"}
    assert names == {"smoke", "quick", "paper", "as_written", "fork", *ablations}


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


def test_a_results_folder_has_the_settings_of_its_study(tmp_path: Path) -> None:
    """A run that was stopped counts, and a file or flags change them."""

    def settings(*flags: str) -> Config:
        _, options = parse(["plan", "--out", str(tmp_path), *flags])
        found: Config = options.config
        return found

    assert settings() == Config()
    published = configuration("--tune.trials=7", "--plugins=[study.examples.cart]")
    facts = {"format": FORMAT, "settings": settings_of(published)}
    write_json(tmp_path / "study.json", facts)
    assert settings() == published
    assert settings("--tune.trials=8").tune.trials == 8
    assert settings("--config", str(DEFAULT)) == Config()
    stopped = configuration("--tune.trials=9")
    write_run_settings(tmp_path, stopped)
    assert settings() == stopped
    (tmp_path / "work" / "settings.json").write_text("{")
    with pytest.raises(BadInput, match=r"settings\.json is damaged; give the settings"):
        settings()
    assert settings("--config", str(DEFAULT)) == Config()
