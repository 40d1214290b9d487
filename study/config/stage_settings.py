"""What each stage depends on: the pipeline fills these dataclasses in, and the stage reads them.

A stage sees these settings and its input folders, and nothing else of the configuration. They are
JSON in a task's key and in its manifest.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

from study.config.model_sections import Network
from study.config.settings import Collect, Ensemble, Evaluate, Tune


@dataclass(frozen=True)
class CollectSettings:
    """Stage collect: observe one environment."""

    environment: str
    collect: Collect


@dataclass(frozen=True)
class RecordDataSettings:
    """Stage record_data: the recording of an environment's training data."""

    environment: str


@dataclass(frozen=True)
class TrainingSet:
    """Which of the environment's training trajectories are used: a range of them.

    Attributes:
        first: index of the first trajectory.
        trajectories: their number N.
    """

    first: int
    trajectories: int

    @classmethod
    def of_level(cls, fraction: float, total: int, seed: int) -> "TrainingSet":
        """The part of the data that a seed has at a level.

        The data are cut into as many parts as there are, such as ten tenths. Seed 0 has the first
        part, seed 1 the second, and so on; after the last part comes the first again.

        Args:
            fraction: of the data, at this level.
            total: number of the environment's training trajectories.
            seed: of the cell.
        """
        exact = Fraction(str(fraction))  # as it is written: a tenth and not its binary neighbour
        count = int(exact * total)
        return cls(seed % int(1 / exact) * count, count)


@dataclass(frozen=True)
class EnsembleSettings:
    """Stage ensemble: the M recurrent networks of an environment, level and seed."""

    training: TrainingSet
    seed: int
    ensemble: Ensemble
    network: Network


@dataclass(frozen=True)
class TrainSettings:
    """Stage train: the fit of one cell's model.

    Attributes:
        training: the training trajectories.
        model: registered name of the model.
        model_settings: JSON of the class's `settings_class`.
        seed: of initial weights, order of the data and sampling.
    """

    training: TrainingSet
    model: str
    model_settings: Mapping[str, Any]
    seed: int


@dataclass(frozen=True)
class TuneSettings:
    """Stage tune: the search for β, by short fits of the cell's model."""

    fit: TrainSettings
    tune: Tune


@dataclass(frozen=True)
class ValidateSettings:
    """Stage validate: scores on the validation scenarios."""

    environment: str
    seed: int
    samples: int


@dataclass(frozen=True)
class EvaluateSettings:
    """Stage evaluate: forecasts of the test scenarios, and their scores."""

    environment: str
    model: str
    seed: int
    evaluate: Evaluate


@dataclass(frozen=True)
class RecordSettings:
    """Stage record: the recordings of a cell."""

    environment: str
    level: str
    model: str
    seed: int


STAGES: Mapping[str, type] = {
    "collect": CollectSettings,
    "record_data": RecordDataSettings,
    "ensemble": EnsembleSettings,
    "tune": TuneSettings,
    "train": TrainSettings,
    "validate": ValidateSettings,
    "evaluate": EvaluateSettings,
    "record": RecordSettings,
}
"""The settings of every stage, in the order in which the stages run."""
