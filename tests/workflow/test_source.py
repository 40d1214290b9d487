"""The source that a task depends on: arithmetic counts, comments and docstrings do not."""

import ast
from pathlib import Path

import pytest

from study.config.grid import Cell
from study.config.settings import Config
from study.workflow import source
from study.workflow.pipeline import Pipeline
from study.workflow.source import source_digests

MODULE = '''"""A module."""

from mylayers.deep import scale

import torch

KERNEL = "kernel.c"


def double(x: float) -> float:
    """Twice x."""
    # The factor.
    return scale(2 * x)
'''
KERNEL = "int two(void) { return 2; }  // the factor\n"


@pytest.fixture
def plugin(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A plugin module that uses a package and a C file beside it."""
    (tmp_path / "myplugin.py").write_text(MODULE)
    (tmp_path / "kernel.c").write_text(KERNEL)
    (tmp_path / "mylayers").mkdir()
    (tmp_path / "mylayers" / "__init__.py").write_text("")
    (tmp_path / "mylayers" / "deep.py").write_text("def scale(x: float) -> float:\n    return x\n")
    monkeypatch.syspath_prepend(tmp_path)
    return tmp_path


def digests() -> dict[str, str]:
    """The digests of the plugin, read again."""
    for cached in (
        source.source_digests,
        source._file,
        source._origin,
        source._tree,
        source._digest,
    ):
        cached.cache_clear()
    return dict(source_digests(("myplugin",)))


def test_a_plugin_reaches_its_own_modules_and_no_installed_ones(plugin: Path) -> None:
    assert set(digests()) == {"myplugin", "mylayers.deep"}


@pytest.mark.parametrize(
    ("file", "old", "new"),
    [
        ("myplugin.py", "# The factor.", "# It is two."),
        ("myplugin.py", '"""Twice x."""', '"""2 x."""'),
        ("myplugin.py", "scale(2 * x)", "scale(\n        2 * x,\n    )"),
        ("kernel.c", "// the factor", "/* the\nfactor */"),
        ("kernel.c", "{ return 2; }", "{\n  return 2;\n}"),
    ],
)
def test_comments_docstrings_and_layout_do_not_count(
    plugin: Path, file: str, old: str, new: str
) -> None:
    before = digests()
    text = (plugin / file).read_text()
    assert old in text
    (plugin / file).write_text(text.replace(old, new))
    assert digests() == before


@pytest.mark.parametrize(
    ("file", "old", "new", "module"),
    [
        ("myplugin.py", "2 * x", "3 * x", "myplugin"),
        ("kernel.c", "return 2", "return 3", "myplugin"),
        ("mylayers/deep.py", "return x", "return -x", "mylayers.deep"),
    ],
)
def test_arithmetic_counts(plugin: Path, file: str, old: str, new: str, module: str) -> None:
    before = digests()
    (plugin / file).write_text((plugin / file).read_text().replace(old, new))
    after = digests()
    assert {name for name in after if after[name] != before[name]} == {module}


def test_a_fit_depends_on_its_own_model_and_on_no_environment() -> None:
    pipeline = Pipeline(Config())
    fits = {
        model: set(pipeline.train(Cell("pusher", "low", model, 0)).source)
        for model in ("residual_vae", "probabilistic_mlp", "residual_crps")
    }
    for model, modules in fits.items():
        assert f"study.models.{model}" in modules
        assert not any(f"study.models.{other}" in modules for other in fits.keys() - {model})
        assert {"study.stages.train", "study.training.fit", "study.models.base"} <= modules
        assert not any(name.startswith(("study.envs.pusher", "study.envs.uav")) for name in modules)
    assert "study.models.unroll.unroll" in fits["residual_vae"]


def test_data_depend_on_their_environment_and_on_no_model() -> None:
    pipeline = Pipeline(Config())
    pusher, uav = (set(pipeline.collect(name).source) for name in ("pusher", "uav"))
    assert "study.envs.pusher" in pusher - uav
    assert "study.envs.uav_physics" in uav - pusher
    assert not any(name.startswith("study.models") for name in pusher | uav)


def test_every_python_writes_a_tree_alike() -> None:
    """Python 3.12 and 3.13 add fields to trees, and leave out empty ones, in `ast.dump`."""
    tree = ast.parse("def f(): return None")
    assert source._dump(tree) == (
        "Module(body=[FunctionDef(name='f', args=arguments(), body=[Return(value=Constant())])])"
    )
