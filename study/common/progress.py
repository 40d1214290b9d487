"""The progress of a stage: one small file, rewritten, that other processes read."""

import json
import time
from copy import copy
from pathlib import Path
from typing import Any

from study.common.files import replacing


class Progress:
    """Called by a stage with the fraction done, in [0, 1], and a message.

    Args:
        path: the file to rewrite; None reports nothing.
        start: fraction of the whole at which this part starts.
        share: this part's share of the whole.
    """

    def __init__(self, path: Path | None = None, start: float = 0.0, share: float = 1.0) -> None:
        self.path, self.start, self.share = path, start, share
        self._last = 0.0

    def __call__(self, fraction: float, message: str = "") -> None:
        now = time.monotonic()
        if now - self._last < 0.25 and fraction < 1:
            return
        self._last = now
        self._tell(self.start + self.share * min(fraction, 1.0), message)

    def part(self, start: float, end: float) -> "Progress":
        """The progress of a part that covers the fractions `start` to `end`."""
        part = copy(self)
        part.start, part.share = self.start + self.share * start, self.share * (end - start)
        return part

    def _tell(self, fraction: float, message: str) -> None:
        if self.path is None:
            return
        state = {"fraction": fraction, "message": message}
        with replacing(self.path) as temporary:
            temporary.write_text(json.dumps(state))


def read_progress(path: Path) -> dict[str, Any]:
    """The last reported ``fraction`` and ``message``; empty if there is none."""
    try:
        state = json.loads(path.read_text())
    except (OSError, ValueError):
        return {}
    return state if isinstance(state, dict) else {}
