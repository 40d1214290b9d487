"""Where Optuna stores the trials of a search: a journal file, or a database of all searches."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

import optuna
from optuna.exceptions import StorageInternalError, UpdateFinishedTrialError
from optuna.samplers import PartialFixedSampler, RandomSampler
from optuna.storages import BaseStorage, JournalStorage, RDBStorage
from optuna.storages.journal import JournalFileBackend
from optuna.trial import FrozenTrial, TrialState
from sqlalchemy.exc import ArgumentError, SQLAlchemyError
from sqlalchemy.pool import NullPool

from study.common.errors import BadInput, StudyError
from study.common.secrets import without_passwords
from study.config.settings import Tune
from study.config.stage_settings import Database
from study.training.search import BETA, ENDED, suggest

NUMBER = "trial"
"""The attribute with the number of a trial that ran in a batch. The trials of a batch start in any
order, so the numbers of Optuna differ from run to run."""
CONNECT = {"postgresql": {"connect_timeout": 10}, "sqlite": {"timeout": 60}}
"""Arguments of a connection: seconds to wait for the server, or for the lock of the file."""


def journal(path: Path) -> BaseStorage:
    """The journal file of one search."""
    return JournalStorage(JournalFileBackend(str(path)))


def database(url: str) -> BaseStorage:
    """The database at `url`, with the tables of Optuna, which are created in an empty one.

    A connection lasts for one transaction, since a server has few of them for many workers.

    Raises:
        BadInput: it cannot be used. The error is one line without the password.
    """
    try:
        return RDBStorage(
            url,
            engine_kwargs={
                "poolclass": NullPool,
                "connect_args": CONNECT.get(url.partition(":")[0].partition("+")[0], {}),
            },
        )
    except ImportError:
        raise BadInput(
            "tune.storage: PostgreSQL needs psycopg: pip install -e '.[postgres]'"
        ) from None
    except (SQLAlchemyError, StorageInternalError, RuntimeError, ValueError) as error:
        raise BadInput(
            f"tune.storage: cannot use {without_passwords(url)}: {_reason(error)}; start the "
            "database, or correct the URL"
        ) from None


def open_search(storage: BaseStorage, name: str) -> optuna.Study:
    """The search of this name, new or resumed."""
    return optuna.create_study(study_name=name, storage=storage, load_if_exists=True)


def shared_search(shared: Database) -> optuna.Study:
    """The search in the database of the study.

    Raises:
        BadInput: the database cannot be used.
    """
    return open_search(database(shared.url), shared.search)


def stored_search(shared: Database | None, out: Path, model: str) -> optuna.Study:
    """The search in the database of the study, or without one in ``journal.log``; new or resumed.

    Args:
        shared: the database.
        out: the folder of ``journal.log``.
        model: whose β is searched.

    Raises:
        BadInput: the database cannot be used.
    """
    if shared is not None:
        return shared_search(shared)
    return open_search(journal(out / "journal.log"), f"beta of {model}")


def fail_running(search: optuna.Study, number: int | None = None) -> None:
    """End the trials whose processes were killed.

    Args:
        search: whose trials are ended.
        number: of the trial of a batch that is ended; None ends all.
    """
    for trial in search.get_trials(deepcopy=False, states=(TrialState.RUNNING,)):
        if number is None or trial.user_attrs.get(NUMBER) == number:
            search.tell(trial.number, state=TrialState.FAIL)


class DatabaseTrial:
    """The copy of a trial in the database, for the dashboard. No result depends on it.

    Args:
        search: in the database.
        trial: of the search.
    """

    def __init__(self, search: optuna.Study, trial: optuna.Trial) -> None:
        self._search, self._trial = search, trial

    def report(self, value: float, step: int) -> None:
        """Store an intermediate score."""
        self._trial.report(value, step)

    def end(self, ended: FrozenTrial) -> None:
        """Store how the trial ended."""
        value = ended.value if ended.state == TrialState.COMPLETE else None
        self._search.tell(self._trial, value, state=ended.state)


@contextmanager
def database_trial(
    shared: Database | None, number: int, beta: float, tune: Tune
) -> Iterator[DatabaseTrial | None]:
    """The copy of a trial of a batch in the database. If the block fails, the copy has failed.

    Args:
        shared: the search; None without a database.
        number: of the trial. Running copies with this number are ended, since their process was
            killed.
        beta: of the trial.
        tune: settings of the search.
    """
    if shared is None:
        yield None
        return
    search = shared_search(shared)
    fail_running(search, number)
    search.sampler = PartialFixedSampler({BETA: beta}, RandomSampler())
    trial = search.ask()
    try:
        trial.set_user_attr(NUMBER, number)
        suggest(trial, tune)
        yield DatabaseTrial(search, trial)
    except BaseException:
        with suppress(Exception):  # the database may be lost, or another process has ended it
            search.tell(trial, state=TrialState.FAIL)
        raise


def complete_search(search: optuna.Study, trials: Sequence[FrozenTrial]) -> None:
    """Add the trials of batches that the search lacks, and end its running trials as failed."""
    fail_running(search)
    present = {trial.user_attrs.get(NUMBER) for trial in search.get_trials(states=ENDED)}
    for number, trial in enumerate(trials):
        if number not in present:
            trial.set_user_attr(NUMBER, number)
            search.add_trial(trial)


@contextmanager
def explained(shared: Database | None) -> Iterator[None]:
    """Explain the loss of the database in one line.

    Raises:
        StudyError: the connection was lost, or another run has ended the trial.
    """
    try:
        yield
    except (SQLAlchemyError, StorageInternalError) as error:
        url = without_passwords(shared.url if shared else "")
        raise StudyError(
            f"tune.storage: lost {url}: {_reason(error)}; run the same command again to go on"
        ) from None
    except UpdateFinishedTrialError:
        raise StudyError(
            "tune.storage: another run has ended this trial; run one study of this name at a time"
        ) from None


def _reason(error: Exception) -> str:
    """The cause of an error of a database, in one line."""
    cause: BaseException = error
    while isinstance(cause.__cause__, Exception):
        cause = cause.__cause__
    text = "it is no URL of a database" if isinstance(cause, ArgumentError) else str(cause)
    return without_passwords(" ".join(text.split()))[:200].rstrip(" .")
