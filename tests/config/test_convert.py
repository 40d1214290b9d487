"""Settings as JSON: what was added later changes no key at its default."""

from dataclasses import asdict, replace

from study.config.convert import by_dotted_name, from_json, to_json
from study.config.grid import Cell
from study.config.settings import Config, Train
from study.config.stage_settings import EnsembleSettings
from study.workflow.pipeline import Pipeline


def test_settings_added_later_are_left_out_at_their_default() -> None:
    assert asdict(Train()).keys() - to_json(Train()).keys() == {"precision"}
    assert to_json(Train(precision="auto"))["precision"] == "auto"
    for train in (Train(), Train(precision="bf16", steps=7)):
        assert from_json(Train, to_json(train)) == train


def test_the_key_of_a_stage_depends_on_them_otherwise() -> None:
    cell = Cell("pusher", "low", "probabilistic_mlp", 0)
    names = ("accelerator", "precision")
    plain = Pipeline(Config())
    other = Pipeline(Config(train=replace(Config().train, precision="bf16", accelerator="cpu")))
    for stage in ("ensemble", "train", "validate", "evaluate"):
        before, after = (getattr(tasks, stage)(cell) for tasks in (plain, other))
        assert before.key != after.key
        found = {name.rpartition(".")[2] for name in by_dotted_name(before.settings)}
        assert not found & set(names) or stage == "train"
    oracle = replace(cell, model="oracle")
    assert plain.evaluate(oracle).key == other.evaluate(oracle).key
    settings = from_json(EnsembleSettings, other.ensemble(cell).settings)
    assert (settings.accelerator, settings.precision) == ("cpu", "bf16")
    assert from_json(EnsembleSettings, plain.ensemble(cell).settings).accelerator == "auto"
