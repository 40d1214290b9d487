"""One run at a time on one results folder."""

import json
import os
import time
from pathlib import Path

import pytest

from study.common.errors import BadInput
from study.workflow.lease import Terms
from study.workflow.lock import LEASE, is_locked, locked, watch


def test_the_second_learns_who_has_it(tmp_path: Path) -> None:
    with locked(tmp_path):
        assert is_locked(tmp_path)
        with pytest.raises(BadInput, match=rf"in use by process {os.getpid()} on .* since "):
            locked(tmp_path).__enter__()
        assert is_locked(tmp_path)
    assert not is_locked(tmp_path)


def test_free_again_after_an_error(tmp_path: Path) -> None:
    with pytest.raises(KeyError), locked(tmp_path):
        raise KeyError
    with locked(tmp_path):
        pass


@pytest.mark.parametrize("left", ["", "{", '{"process": 1}', json.dumps(["not", "facts"])])
def test_what_a_killed_run_left_locks_nothing(tmp_path: Path, left: str) -> None:
    (tmp_path / ".lock").touch()
    (tmp_path / ".lock.json").write_text(left)
    assert not is_locked(tmp_path)
    with locked(tmp_path):
        (tmp_path / ".lock.json").write_text(left)
        with pytest.raises(BadInput, match="in use by another run"):
            locked(tmp_path).__enter__()


def test_a_run_on_a_machine_that_was_lost(tmp_path: Path) -> None:
    """It counts until its lease was not renewed for as long as it lasts."""
    with locked(tmp_path, Terms(seconds=1.0)):
        content = json.loads((tmp_path / LEASE).read_text())
    (tmp_path / LEASE).write_text(json.dumps(content | {"system": "elsewhere"}))
    observed = watch(tmp_path)
    assert is_locked(tmp_path, observed)
    time.sleep(0.6)
    os.utime(tmp_path / LEASE)
    time.sleep(0.6)
    assert is_locked(tmp_path, observed)
    time.sleep(1.0)
    assert not is_locked(tmp_path, observed)


def test_what_a_run_left_that_was_killed_while_it_took_the_lock(tmp_path: Path) -> None:
    (tmp_path / f"{LEASE}.0123456789ab").touch()
    with locked(tmp_path):
        assert {path.name for path in tmp_path.iterdir()} == {".lock", LEASE}


def test_asking_writes_nothing(tmp_path: Path) -> None:
    assert not is_locked(tmp_path)
    assert not list(tmp_path.iterdir())
