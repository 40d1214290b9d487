"""Import the user's modules, which register environments and models."""

import importlib
import os
import sys
import sysconfig
import traceback
from collections.abc import Iterable

from study.common.errors import BadInput

LIBRARIES = tuple(sysconfig.get_path(name) for name in ("stdlib", "purelib", "platlib"))


def import_plugins(names: Iterable[str]) -> None:
    """Import the user's modules, which register environments and models.

    Raises:
        BadInput: a module cannot be imported, or what it registers cannot be used.
    """
    folder = os.getcwd()
    if folder not in sys.path:
        sys.path.insert(0, folder)
    for name in names:
        if name.endswith(".py") or not all(part.isidentifier() for part in name.split(".")):
            raise BadInput(f"plugins: '{name}' is no module; write my_system, or package.module")
        try:
            importlib.import_module(name)
        except BadInput as error:
            raise BadInput(f"plugins: {error}") from None
        except (Exception, SystemExit) as error:
            raise BadInput(f"plugins: cannot import '{name}': {reason(error)}") from None


def reason(error: BaseException) -> str:
    """What went wrong in code of the user, and the file and line where it did, in one line."""
    text = " ".join(str(error).split())[:200]
    if isinstance(error, SyntaxError):
        return f"{error.msg} ({error.filename}, line {error.lineno})" if error.filename else text
    frames = traceback.extract_tb(error.__traceback__)
    skipped = ("<", __file__, *LIBRARIES)
    lines = [frame for frame in frames if not frame.filename.startswith(skipped)]
    kind = "" if isinstance(error, ImportError) else f"{type(error).__name__}: "
    where = f" ({lines[-1].filename}, line {lines[-1].lineno})" if lines else ""
    return f"{kind}{text}{where}"
