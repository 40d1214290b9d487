"""The search for β in a database: PostgreSQL and SQLite choose what the journal chooses."""

import shutil
import sys
from pathlib import Path

import optuna
import pytest
from optuna.exceptions import StorageInternalError
from optuna.trial import TrialState
from sqlalchemy.exc import OperationalError

from study.common.errors import BadInput, StudyError
from study.common.secrets import without_passwords
from study.config.grid import Cell
from study.config.stage_settings import Database
from study.config.tree import to_json
from study.training.search_storage import database, explained
from study.workflow.lease import Terms, hold
from study.workflow.pipeline import Pipeline
from study.workflow.searches import with_database
from study.workflow.store import Store
from study.workflow.worker import execute
from tests.helpers.postgres import PASSWORD
from tests.helpers.running import SMALL, configuration, study

CELL = Cell("cart", "low", "full_vae", 0)
UNREACHABLE = f"postgresql://me:{PASSWORD}@127.0.0.1:1/study"


def test_the_same_beta_as_with_the_journal(small: Path, tmp_path: Path, url: str) -> None:
    """Another process was killed in the first trial of the search."""
    config = configuration(*SMALL, "--tune.storage", url)
    plain = Pipeline(configuration(*SMALL)).tune(CELL)
    store, done = Store(tmp_path), Store(small / "work")
    (task,) = with_database([Pipeline(config).tune(CELL)], config)
    assert task == plain
    for source in task.inputs.values():
        shutil.copytree(done.folder(source), store.folder(source))
    name = f"smoke/{CELL.name} {task.key[:16]}"
    optuna.create_study(storage=database(url), study_name=name).ask()
    assert execute(task, store.root, 1).error is None
    expected = (done.folder(plain) / "tuning.json").read_bytes()
    assert (store.folder(task) / "tuning.json").read_bytes() == expected
    assert not (store.folder(task) / "journal.log").exists()
    (summary,) = optuna.get_all_study_summaries(database(url))
    trials = optuna.load_study(study_name=summary.study_name, storage=database(url)).trials
    states = [trial.state for trial in trials]
    assert summary.study_name == name
    assert states[0] == TrialState.FAIL
    assert len(states) == 5
    assert TrialState.RUNNING not in states
    for path in store.root.rglob("*"):
        is_text = path.is_file() and path.suffix not in (".safetensors", ".db")
        assert not is_text or url not in path.read_text(errors="replace"), path


def test_neither_keys_nor_stored_settings_have_the_url() -> None:
    plain, shared = configuration(*SMALL), configuration(*SMALL, "--tune.storage", UNREACHABLE)
    assert Pipeline(plain).train(CELL).key == Pipeline(shared).train(CELL).key
    assert to_json(plain) == to_json(shared)
    (task,) = with_database([Pipeline(shared).collect("cart")], shared)
    assert not task.services


def test_a_database_that_cannot_be_reached(tmp_path: Path) -> None:
    pytest.importorskip("psycopg")
    done = study("all", *SMALL, "--tune.storage", UNREACHABLE, "--out", tmp_path)
    assert done.code == 2
    assert done.err.startswith("error: tune.storage: cannot use postgresql://me:***@127.0.0.1:1/")
    assert "Connection refused" in done.err
    assert len(done.err.splitlines()) == 1
    files = [path.read_text() for path in tmp_path.rglob("*") if path.is_file()]
    assert not [text for text in (*files, done.err) if PASSWORD in text]


def test_without_psycopg(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "psycopg", None)
    with pytest.raises(BadInput, match=r"PostgreSQL needs psycopg: pip install -e '.\[postgres\]'"):
        database(UNREACHABLE)


@pytest.mark.parametrize("given", ["mysql://me:secret@host/x", "x", "postgresql://a:secret@b@c/x"])
def test_what_is_no_url_of_a_database(given: str) -> None:
    with pytest.raises(BadInput) as raised:
        configuration(*SMALL, "--tune.storage", given)
    assert "it must be a URL such as" in str(raised.value)
    assert "secret" not in str(raised.value)


def test_a_lease_names_the_command_without_the_password(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "argv", ["study.run", "all", "--tune.storage", UNREACHABLE])
    with hold(tmp_path / "lease", Terms()):
        text = (tmp_path / "lease").read_text()
    assert "all --tune.storage postgresql://me:***@127.0.0.1:1/study" in text


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("postgresql://a:b@c@d/e is", "postgresql://a:***@d/e is"),
        ("postgresql://a@d/e?password=b&x=1", "postgresql://a@d/e?password=***&x=1"),
        ("postgresql://a@d/e?password=b'c", "postgresql://a@d/e?password=***"),
        ("postgresql://d:5432/e?password=b@c", "postgresql://d:5432/e?password=***"),
        ("postgresql://a/b:c@d/e", "postgresql://a/b:***@d/e"),
        ("http://d:80/e", "http://d:80/e"),
        ("sqlite:////a/b.db", "sqlite:////a/b.db"),
    ],
)
def test_passwords_are_hidden(text: str, expected: str) -> None:
    assert without_passwords(text) == expected


def test_a_database_that_is_lost_during_a_search() -> None:
    """What Optuna raises has the cause of the driver, of which the error has the text."""
    cause = OperationalError("SELECT 1", {}, Exception("server closed the connection"))
    with (
        pytest.raises(StudyError, match=r"lost postgresql://me:\*\*\*@.*run the same command"),
        explained(Database(UNREACHABLE, "a search")),
    ):
        raise StorageInternalError("An exception is raised during the commit.") from cause


def test_a_process_whose_trial_another_run_has_ended() -> None:
    """It was stopped, and the search went on elsewhere."""
    search = optuna.create_study()
    trial = search.ask()
    search.tell(trial.number, state=TrialState.FAIL)
    with pytest.raises(StudyError, match="another run has ended this trial"), explained(None):
        trial.report(1.0, 1)
