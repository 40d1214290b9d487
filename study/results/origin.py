"""The origin of the results of a study: versions, device, compiler, threads and source.

Each stage writes its origin into its manifest, and ``study.json`` collects them. So the origin is
that of the process that computed the numbers, not of the process that publishes or reads them.
"""

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from study.common.files import read_json
from study.common.provenance import MANIFEST
from study.config.grid import Cell
from study.config.names import FROM_DATA, ORACLE
from study.workflow.source import source_digests
from study.workflow.store import Store
from study.workflow.task import Task

SEPARATOR = "; "
"""Separates values that differ between stages."""
DIGITS = 16
"""Number of digits of the digest of a module."""
RECORDED = "study.envs.recorded"
"""The module of every recorded system."""
NAMED = 3
"""Largest number of modules that a message names."""


@dataclass(frozen=True)
class Origin:
    """The origin of results. A value that differs between stages is a list in one string.

    Attributes:
        versions: of Python and of packages, by name.
        device: processor, and GPU if one was used.
        compiler: of the networks' rollouts.
        threads: of each stage.
        source: digest of every module that a stage reached, by name (`study.workflow.source`).
    """

    versions: Mapping[str, str]
    device: str = ""
    compiler: str = ""
    threads: str = ""
    source: Mapping[str, str] = field(default_factory=dict)

    def changed_source(self, cells: Iterable[Cell]) -> str | None:
        """A message if the source differs from that of the results; None if it is the same.

        Args:
            cells: the cells whose environments and models are compared.
        """
        from study.envs import simulators  # torch takes seconds to import
        from study.models.checkpoints import class_of

        if not self.source:
            return "it is unknown with which source of environments and models these were made"
        registered: list[str] = []
        for cell in cells:
            is_simulator = cell.environment in simulators
            module = simulators[cell.environment].__module__ if is_simulator else RECORDED
            registered.append(module)
            if cell.model not in (ORACLE, *FROM_DATA):
                registered.append(class_of(cell.model).__module__)
        registered = list(dict.fromkeys(registered))
        current = source_digests(tuple(registered))
        changed = [name for name in current if self.source.get(name) != current[name][:DIGITS]]
        if not changed:
            return None
        # Environments and models come first.
        changed.sort(key=lambda name: (name not in registered, name))
        names = ", ".join(changed[:NAMED]) + " …" * (len(changed) > NAMED)
        return f"the source has changed since these were made: {names}; scores may differ"


def of_tasks(tasks: Iterable[Task], store: Store) -> Origin:
    """The origin of results, from the manifests of their tasks."""
    parts = []
    for task in tasks:
        try:
            runtime = dict(read_json(store.folder(task) / MANIFEST)["runtime"])
        except (OSError, ValueError, KeyError, TypeError):  # missing or damaged: it runs again
            continue
        source = {name: digest[:DIGITS] for name, digest in task.source.items()}
        parts.append(from_json({"versions": {}} | runtime | {"source": source}))
    return join(parts)


def join(parts: Iterable[Origin]) -> Origin:
    """The origin of results that several processes computed."""
    parts = list(parts)

    def merged(values: Iterable[str]) -> str:
        return SEPARATOR.join(sorted({value for value in values if value}))

    def merged_mapping(mappings: Iterable[Mapping[str, str]]) -> dict[str, str]:
        mappings = list(mappings)
        names = sorted({name for mapping in mappings for name in mapping})
        return {name: merged(mapping.get(name, "") for mapping in mappings) for name in names}

    return Origin(
        merged_mapping(part.versions for part in parts),
        merged(part.device for part in parts),
        merged(part.compiler for part in parts),
        merged(part.threads for part in parts),
        merged_mapping(part.source for part in parts),
    )


def to_json(origin: Origin) -> dict[str, Any]:
    """The entries of ``study.json``."""
    return asdict(origin)


def from_json(facts: Mapping[str, Any]) -> Origin:
    """The origin from the result of `to_json`. Earlier versions of the study wrote only versions.

    Raises:
        KeyError: there are no versions.
    """
    device, compiler, threads = (
        str(facts.get(name, "")) for name in ("device", "compiler", "threads")
    )
    versions, source = (
        {str(name): str(value) for name, value in mapping.items()}
        for mapping in (facts["versions"], facts.get("source", {}))
    )
    return Origin(versions, device, compiler, threads, source)
