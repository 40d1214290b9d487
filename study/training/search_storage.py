"""Where Optuna stores the trials of a search: a journal file, or a database of all searches."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from optuna.exceptions import StorageInternalError, UpdateFinishedTrialError
from optuna.storages import BaseStorage, JournalStorage, RDBStorage
from optuna.storages.journal import JournalFileBackend
from sqlalchemy.exc import ArgumentError, SQLAlchemyError
from sqlalchemy.pool import NullPool

from study.common.errors import BadInput, StudyError
from study.common.secrets import without_passwords

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


@contextmanager
def explained(url: str | None) -> Iterator[None]:
    """Explain the loss of the database in one line.

    Raises:
        StudyError: the connection was lost, or another run has ended the trial.
    """
    try:
        yield
    except (SQLAlchemyError, StorageInternalError) as error:
        raise StudyError(
            f"tune.storage: lost {without_passwords(url or '')}: {_reason(error)}; run the same "
            "command again to go on"
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
