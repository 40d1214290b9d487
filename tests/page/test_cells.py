"""Tables of models and cells: what a fit costs."""

from types import SimpleNamespace
from typing import Any

import pytest

from study.page.cells import _cost


@pytest.mark.parametrize("searched", [{"tune": 6.0}, {"trial": 2.0, "select": 2.0}])
def test_a_fit_costs_its_search_in_one_task_or_in_several(searched: dict[str, float]) -> None:
    """The mean over seeds of all tasks of a seed."""
    costs: dict[str, Any] = {"ensemble uav/low/seed-0": {"cpu_seconds": 99.0}}
    for seed in (0, 1):
        cell = f"uav/low/full_vae/seed-{seed}"
        costs[f"train {cell}"] = {"cpu_seconds": 10.0 + seed, "peak_memory": 1e6}
        for stage, seconds in searched.items():
            parts = ["/trial-0", "/trial-1"] if stage == "trial" else [""]
            for part in parts:
                costs[f"{stage} {cell}{part}"] = {"cpu_seconds": seconds, "peak_memory": 2e6}
    evidence: Any = SimpleNamespace(costs=costs)
    cpu, memory = _cost(evidence, "uav", "low", "full_vae")
    assert (cpu.order, memory.text) == (16.5, "2")
    assert _cost(evidence, "uav", "low", "ensemble")[0].order == 99.0
