"""The cells of the study: environment × epistemic level × model × seed."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from itertools import product

from study.common.errors import BadInput, nearest
from study.config.names import BEYOND, ENSEMBLE, FROM_DATA, MODELS, ORACLE
from study.config.recorded import recorded_of
from study.config.settings import Config, Grid

REFERENCES = (ORACLE, ENSEMBLE)
"""Reference forecasters, scored by the same code as every model."""
RECORDED_REFERENCES = (ENSEMBLE, *FROM_DATA)
"""Those of a recorded system, which has no oracle."""


@dataclass(frozen=True, order=True)
class Cell:
    """One model, trained on the data of one environment at one epistemic level, with one seed."""

    environment: str
    level: str
    model: str
    seed: int

    @property
    def name(self) -> str:
        """`pusher/low/residual_vae/seed-0`, also the path of the cell's files."""
        return f"{self.environment}/{self.level}/{self.model}/seed-{self.seed}"

    @property
    def evaluation(self) -> str:
        """The name of the cell's evaluation. That of the oracle, which has no level, is shared."""
        if self.model == ORACLE:
            return f"{self.environment}/{ORACLE}/seed-{self.seed}"
        return self.name

    @property
    def is_reference(self) -> bool:
        """Whether this is no model of the grid."""
        return self.model in (*REFERENCES, *RECORDED_REFERENCES)


GROUPS = {"paper": MODELS, "all": (*MODELS, *BEYOND)}
"""Names for several models: ``--grid.models all``."""


def with_groups(grid: Grid) -> Grid:
    """The grid with every group replaced by its models, each model once."""
    named = [model for name in grid.models for model in GROUPS.get(name, (name,))]
    groups = any(name in GROUPS for name in grid.models)
    return replace(grid, models=tuple(dict.fromkeys(named) if groups else named))


def cells(config: Config) -> list[Cell]:
    """Every cell of the grid. The references come after the models."""
    grid = config.grid
    return [
        Cell(environment, level, model, seed)
        for environment, level, seed in product(grid.environments, grid.levels, grid.seeds)
        for model in (*grid.models, *references(config, environment))
    ]


def references(config: Config, environment: str) -> tuple[str, ...]:
    """The reference forecasters of an environment."""
    return REFERENCES if recorded_of(config, environment) is None else RECORDED_REFERENCES


def matches(cell: Cell, pattern: str) -> bool:
    """Whether a pattern such as ``pusher/high/*`` or ``pusher`` matches the cell."""
    return fnmatchcase(cell.name, pattern) or fnmatchcase(cell.name, pattern + "/*")


def among(cell: Cell, patterns: Iterable[str]) -> bool:
    """Whether any of the patterns matches the cell."""
    return any(matches(cell, pattern) for pattern in patterns)


def select(every: list[Cell], only: str | None) -> list[Cell]:
    """The cells whose name matches the pattern `only`, such as ``pusher/high/*``.

    Raises:
        BadInput: none matches.
    """
    if only is None:
        return every
    chosen = [cell for cell in every if matches(cell, only)]
    if not chosen:
        names = [cell.name for cell in every]
        raise BadInput(f"--only: no cell matches '{only}'; {nearest(only, names)}")
    return chosen
