"""Registered classes: names that cannot be used, and two classes with one name."""

import sys
from pathlib import Path
from types import ModuleType

import pytest

from study.common.errors import BadInput
from study.common.registry import LONGEST, RESERVED, Registry, check_name, missing

ANIMAL = "class Animal: pass"


def module(name: str, file: Path, monkeypatch: pytest.MonkeyPatch) -> type:
    """The class `Animal` of a module that is imported as `name` from `file`."""
    found = ModuleType(name)
    found.__file__ = str(file)
    monkeypatch.setitem(sys.modules, name, found)
    exec(ANIMAL, found.__dict__)
    animal: type = found.__dict__["Animal"]
    return animal


@pytest.mark.parametrize(
    "name",
    ["", "up/down", "50%_a&b#c$d", "a b", "-a", "_a", ".a", "ä", "a\n", "x" * 300, None, 3, "."],
)
def test_a_name_that_paths_or_tables_cannot_have(name: object) -> None:
    with pytest.raises(BadInput) as caught:
        check_name("model", name, "my_models.Net")
    line = str(caught.value)
    assert line.startswith("my_models.Net: '")
    assert len(line) < 200


@pytest.mark.parametrize("name", [*RESERVED, "Oracle"])
def test_a_name_with_another_meaning(name: str) -> None:
    with pytest.raises(BadInput, match=f"'{name}' cannot name an environment; all, analogues"):
        check_name("environment", name)


@pytest.mark.parametrize("name", ["cart", "7", "residual_vae", "a-b", "x" * LONGEST])
def test_other_names(name: str) -> None:
    check_name("model", name)


def test_two_classes_with_one_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """That they have the same name in their modules as well makes no difference."""
    animals: Registry[type] = Registry("animal")
    one = module("one", tmp_path / "one.py", monkeypatch)
    other = module("other", tmp_path / "other.py", monkeypatch)
    animals.register("cat")(one)
    with pytest.raises(BadInput, match=r"other\.Animal: one\.Animal is already .* as 'cat'"):
        animals.register("cat")(other)
    assert animals["cat"] is one


def test_the_same_source_imported_twice(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    animals: Registry[type] = Registry("animal")
    one = module("one", tmp_path / "one.py", monkeypatch)
    animals.register("cat")(one)
    again = module("package.one", tmp_path / "one.py", monkeypatch)
    animals.register("cat")(again)
    assert animals["cat"] is again


def test_a_class_that_fails_its_check_is_not_registered() -> None:
    def check(member: type) -> None:
        if lacks := missing(member, ("legs",)):
            raise BadInput(f"{member.__name__} lacks {lacks}")

    animals: Registry[type] = Registry("animal", check)
    with pytest.raises(BadInput, match="Path lacks"):
        animals.register("path")(Path)
    assert list(animals) == []
