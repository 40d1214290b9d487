"""The source that a task depends on: a digest of every module that its stage reaches.

The digest of a module is computed from its syntax tree without docstrings. An edit of comments,
docstrings or layout does not change the digest; every other edit does, so that the stage runs
again. Data files in the folder of a module count if the module contains their names (a C kernel, a
MuJoCo scene). Their comments do not count.

A module reaches the modules that its import statements name, if these belong to the study or to a
plugin. Imports of a package from itself (``from study.models import full_vae``) do not count, since
the registries import all environments and models. A task depends on one of each.
"""

import ast
import hashlib
import re
import sysconfig
from collections.abc import Iterator, Mapping
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

DATA_FILES = (".c", ".h", ".xml")
"""Endings of data files that count as source."""

INSTALLED = tuple(
    Path(sysconfig.get_path(name)).resolve() for name in ("stdlib", "purelib", "platlib")
)
"""Folders of installed packages, whose versions are in the manifests instead."""


@cache
def source_digests(modules: tuple[str, ...]) -> Mapping[str, str]:
    """The digests, by name, of `modules` and of all modules that these reach.

    Args:
        modules: dotted names.
    """
    digests: dict[str, str] = {}
    waiting = list(modules)
    while waiting:
        name = waiting.pop()
        path = _file(name)
        if name in digests or path is None:
            continue
        digests[name] = _digest(path)
        waiting += _imports(name, path)
    return dict(sorted(digests.items()))


@cache
def _file(name: str) -> Path | None:
    """The source file of a module; None if it has none, or is part of an installed package.

    The module is not imported, since the import of its package takes seconds.
    """
    top, *parts = name.split(".")
    origin = _origin(top)
    if origin is None:
        return None
    path = origin.parent.joinpath(*parts) if parts else origin
    if path.with_suffix(".py").is_file():
        return path.with_suffix(".py")
    return path / "__init__.py" if (path / "__init__.py").is_file() else None


@cache
def _origin(top: str) -> Path | None:
    """The file of a top-level module or package; None if it is installed."""
    try:
        spec = find_spec(top)
    except (ImportError, ValueError):
        return None
    if spec is None or spec.origin is None or not spec.origin.endswith(".py"):
        return None
    path = Path(spec.origin).resolve()
    return None if any(folder in path.parents for folder in INSTALLED) else path


@cache
def _tree(path: Path) -> ast.Module:
    """The syntax tree of a module, without docstrings."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            node.body = [statement for statement in node.body if not _is_docstring(statement)]
    return tree


def _is_docstring(statement: ast.stmt) -> bool:
    """Whether a statement is the docstring of a module, class, function or attribute."""
    return (
        isinstance(statement, ast.Expr)
        and isinstance(statement.value, ast.Constant)
        and isinstance(statement.value.value, str)
    )


@cache
def _digest(path: Path) -> str:
    digest = hashlib.sha256(_dump(_tree(path)).encode())
    for file in sorted(_data_files(path)):
        digest.update(_without_comments(file).encode())
    return digest.hexdigest()


def _dump(node: Any) -> str:
    """A syntax tree as text. `ast.dump` writes the same tree differently in other Pythons."""
    if isinstance(node, ast.AST):
        values = [(name, value) for name, value in ast.iter_fields(node) if value not in (None, [])]
        return f"{type(node).__name__}({', '.join(f'{n}={_dump(value)}' for n, value in values)})"
    if isinstance(node, list):
        return f"[{', '.join(map(_dump, node))}]"
    return repr(node)


def _data_files(path: Path) -> set[Path]:
    """The data files in a module's folder whose names are string constants of the module."""
    names = {
        node.value
        for node in ast.walk(_tree(path))
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
    }
    named = {path.with_name(Path(name).name) for name in names if name.endswith(DATA_FILES)}
    return {file for file in named if file.is_file()}


def _without_comments(path: Path) -> str:
    if path.suffix == ".xml":
        return ElementTree.canonicalize(from_file=path, strip_text=True)
    text = re.sub(r"/\*.*?\*/|//[^\n]*", " ", path.read_text(encoding="utf-8"), flags=re.DOTALL)
    return " ".join(text.split())


def _imports(name: str, path: Path) -> Iterator[str]:
    """The modules that the import statements of a module name, at the top or inside functions."""
    package = name if path.name == "__init__.py" else name.rpartition(".")[0]
    for node in ast.walk(_tree(path)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = _absolute(node, package)
            if base == name:  # a package that imports its own modules to register them
                continue
            yield base
            # A name that is imported from a package may be a module.
            yield from (f"{base}.{alias.name}" for alias in node.names)


def _absolute(node: ast.ImportFrom, package: str) -> str:
    """The dotted name after `from`, without leading dots."""
    if not node.level:
        return node.module or ""
    parent = package.rsplit(".", node.level - 1)[0] if node.level > 1 else package
    return f"{parent}.{node.module}" if node.module else parent
