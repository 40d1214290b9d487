"""The progress of a stage: a small file, written again and again, that another process reads."""

import json
import time
from copy import copy
from pathlib import Path
from typing import Any

from study.common.files import replacing

INTERVAL = 0.25
"""Seconds between two reports, at least."""


class Progress:
    """A stage calls it with the fraction done, in [0, 1], and a message.

    Args:
        path: the file to write; None writes nothing.
        start: fraction of the whole at which this part begins.
        share: fraction of the whole that this part takes.
    """

    def __init__(self, path: Path | None = None, start: float = 0.0, share: float = 1.0) -> None:
        self.path, self.start, self.share = path, start, share
        self._last = 0.0

    def __call__(self, fraction: float, message: str = "") -> None:
        now = time.monotonic()
        if now - self._last < INTERVAL and fraction < 1:
            return
        self._last = now
        self._report(self.start + self.share * min(fraction, 1.0), message)

    def part(self, start: float, end: float) -> "Progress":
        """The progress of a part that takes from `start` to `end` of this one."""
        part = copy(self)
        part.start, part.share = self.start + self.share * start, self.share * (end - start)
        return part

    def _report(self, fraction: float, message: str) -> None:
        if self.path is not None:
            with replacing(self.path) as temporary:
                text = json.dumps({"fraction": fraction, "message": message})
                temporary.write_text(text, encoding="utf-8")


def read_progress(path: Path) -> dict[str, Any]:
    """The last `{"fraction", "message"}` in the file; empty if there is none."""
    try:
        state = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return state if isinstance(state, dict) else {}
