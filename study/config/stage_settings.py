"""What each stage depends on: the pipeline fills these dataclasses in, and the stage reads them.

A stage sees these settings and its input folders, and nothing else of the configuration. They are
JSON in a task's key and in its manifest.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from itertools import accumulate
from typing import Any

from study.config.model_sections import Network
from study.config.recorded import Recorded
from study.config.sections import setting
from study.config.settings import Collect, Ensemble, Evaluate, Tune


@dataclass(frozen=True)
class CollectSettings:
    """Stage collect: observe one environment.

    Attributes:
        environment: its name.
        collect: settings of the data.
        recorded: settings of a recorded system; None for a simulator. The same in other stages.
        files: SHA-256 of each log of a recorded system, by its path.
    """

    environment: str
    collect: Collect
    recorded: Recorded | None = None
    files: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class RecordDataSettings:
    """Stage record_data: the recording of an environment's training data."""

    environment: str
    recorded: Recorded | None = None


@dataclass(frozen=True)
class TrainingSet:
    """Which of the environment's training trajectories are used: a range of them.

    Attributes:
        first: index of the first trajectory.
        trajectories: their number N.
        of: None counts trajectories. A number divides the trajectories of a recorded system, whose
            number is not known before they are read, into as many parts; `first` and
            `trajectories` then count parts.
    """

    first: int
    trajectories: int
    of: int | None = None

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

    @classmethod
    def of_recorded(cls, fraction: float, seed: int) -> "TrainingSet":
        """The part of the trajectories of a recorded system; see `of_level`."""
        parts = Fraction(str(fraction)).denominator
        return replace(cls.of_level(fraction, parts, seed), of=parts)

    def rows(self, windows: Sequence[int] = ()) -> slice:
        """The rows of the data set, which has the windows of whole trajectories one by one.

        Args:
            windows: the number of windows of each trajectory of a recorded system.
        """
        if self.of is None:
            return slice(self.first, self.first + self.trajectories)
        count, ends = len(windows), [0, *accumulate(windows)]
        first = min(self.first * count // self.of, count - 1)
        end = max(first + 1, (self.first + self.trajectories) * count // self.of)
        return slice(ends[first], ends[end])


@dataclass(frozen=True)
class EnsembleSettings:
    """Stage ensemble: the M recurrent networks of an environment, level and seed.

    Attributes:
        training: the training trajectories.
        seed: of initial weights, order of the data and sampling.
        ensemble, network: settings of the networks.
        accelerator, precision: see `Train`.
    """

    training: TrainingSet
    seed: int
    ensemble: Ensemble
    network: Network
    accelerator: str = setting("auto", added_later=True)
    precision: str = setting("32", added_later=True)


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
class Database:
    """A search in a database of Optuna.

    Attributes:
        url: of the database; it may have a password.
        search: name of the search in the database.
    """

    url: str
    search: str


@dataclass(frozen=True)
class TuneSettings:
    """Stage tune: the search for β, by short fits of the cell's model.

    Attributes:
        fit: the fit of the cell's model, which a trial shortens.
        tune: settings of the search.
        database: of the trials; None for a journal file. The task's key does not depend on it.
    """

    fit: TrainSettings
    tune: Tune
    database: Database | None = field(default=None, metadata={"stored": False})


@dataclass(frozen=True)
class TrialSettings(TuneSettings):
    """Stage trial: one trial of a search whose trials run in batches.

    Attributes:
        number: of the trial, from 0.
    """

    number: int = field(kw_only=True)


@dataclass(frozen=True)
class SelectSettings:
    """Stage select: the best β of the trials of a search.

    Attributes:
        model: registered name of the model.
        tune: settings of the search.
        database: see `TuneSettings`.
    """

    model: str
    tune: Tune
    database: Database | None = field(default=None, metadata={"stored": False})


@dataclass(frozen=True)
class ValidateSettings:
    """Stage validate: scores on the validation scenarios. `accelerator`: see `Train`."""

    environment: str
    seed: int
    samples: int
    recorded: Recorded | None = None
    accelerator: str = setting("auto", added_later=True)


@dataclass(frozen=True)
class EvaluateSettings:
    """Stage evaluate: forecasts of the test scenarios, and their scores.

    Attributes:
        environment: its name.
        model: name of the forecaster.
        seed: of the forecasts.
        evaluate: settings of the scores.
        recorded: see `CollectSettings`.
        training: the training trajectories of a reference that forecasts from them.
        accelerator: see `Train`.
    """

    environment: str
    model: str
    seed: int
    evaluate: Evaluate
    recorded: Recorded | None = None
    training: TrainingSet | None = None
    accelerator: str = setting("auto", added_later=True)


@dataclass(frozen=True)
class RecordSettings:
    """Stage record: the recordings of a cell."""

    environment: str
    level: str
    model: str
    seed: int
    recorded: Recorded | None = None


STAGES: Mapping[str, type] = {
    "collect": CollectSettings,
    "record_data": RecordDataSettings,
    "ensemble": EnsembleSettings,
    "tune": TuneSettings,
    "trial": TrialSettings,
    "select": SelectSettings,
    "train": TrainSettings,
    "validate": ValidateSettings,
    "evaluate": EvaluateSettings,
    "record": RecordSettings,
}
"""The settings of every stage, in the order in which the stages run."""
