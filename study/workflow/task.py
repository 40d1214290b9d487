"""A task: one run of one stage, and its dependencies."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from study.common.files import digest


@dataclass(frozen=True)
class Task:
    """One run of one stage.

    Attributes:
        stage: name of the stage.
        label: the environment, the ensemble or the cell: `pusher`, `pusher/low/seed-0`, or the
            cell's name.
        settings: JSON of the stage's settings (`study.config.stage_settings`).
        inputs: earlier tasks, by the stage's name for their folder.
        source: digest of every module that the stage reaches, by name (`study.workflow.source`).
        plugins: modules to import first. The key does not depend on them.
        services: further settings of the stage: what it uses and no result depends on, such as the
            database of its trials. Neither the key nor a file has them.
    """

    stage: str
    label: str
    settings: Mapping[str, Any]
    inputs: Mapping[str, "Task"] = field(default_factory=dict)
    source: Mapping[str, str] = field(default_factory=dict)
    plugins: tuple[str, ...] = ()
    services: Mapping[str, Any] = field(default_factory=dict, repr=False)

    @cached_property
    def key(self) -> str:
        """Hash of the stage, its source, its settings and the keys of its inputs."""
        inputs = {name: task.key for name, task in self.inputs.items()}
        return digest([self.stage, dict(self.source), dict(self.settings), inputs])

    @property
    def name(self) -> str:
        """Stage and label, such as `train pusher/low/full_vae/seed-0`."""
        return f"{self.stage} {self.label}"

    def __hash__(self) -> int:
        return hash(self.key)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Task) and self.key == other.key
