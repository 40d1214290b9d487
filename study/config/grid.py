"""The cells of the study: environment × epistemic level × model × seed."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from itertools import product

from study.common.errors import BadInput, nearest
from study.config.names import BEYOND, MODELS
from study.config.settings import Config, Grid

# Reference forecasters, scored by the same code as every model.
REFERENCES = ("oracle", "ensemble")


@dataclass(frozen=True, order=True)
class Cell:
    """One model, trained on one amount of data of one environment, with one seed."""

    environment: str
    level: str
    model: str
    seed: int

    @property
    def name(self) -> str:
        """`pusher/low/residual_vae/seed-0`: the cell's path, wherever it leaves something."""
        return f"{self.environment}/{self.level}/{self.model}/seed-{self.seed}"

    @property
    def is_reference(self) -> bool:
        """Whether this is the oracle or the ensemble alone."""
        return self.model in REFERENCES


# Models by one name: ``--grid.models all``.
GROUPS = {"paper": MODELS, "all": (*MODELS, *BEYOND)}


def with_groups(grid: Grid) -> Grid:
    """The grid with the names of groups replaced by their models, each once."""
    named = [model for name in grid.models for model in GROUPS.get(name, (name,))]
    groups = any(name in GROUPS for name in grid.models)
    return replace(grid, models=tuple(dict.fromkeys(named) if groups else named))


def cells(config: Config) -> list[Cell]:
    """Every cell of the grid, the models first and the references after them."""
    grid = config.grid
    return [
        Cell(environment, level, model, seed)
        for environment, level, seed in product(grid.environments, grid.levels, grid.seeds)
        for model in (*grid.models, *REFERENCES)
    ]


def matches(cell: Cell, pattern: str) -> bool:
    """Whether a pattern such as ``pusher/high/*`` means the cell; all below it are meant."""
    return fnmatchcase(cell.name, pattern) or fnmatchcase(cell.name, pattern + "/*")


def among(cell: Cell, patterns: Iterable[str]) -> bool:
    """Whether any of the patterns means the cell."""
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
