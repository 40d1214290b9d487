"""A trial of the search for β, as ``tuning.json`` holds it."""

from typing import Any


def score(trial: dict[str, Any]) -> float | None:
    """Its score; of a trial that was pruned the last that it reported, of one without any None."""
    told = trial["intermediate"]
    if trial["value"] is not None or not told:
        return trial["value"]
    return float(told[max(told, key=int)])  # as text, step 50 comes after step 200
