"""One run at a time on one results folder."""

import json
import os
from pathlib import Path

import pytest

from study.common.errors import BadInput
from study.workflow.lock import is_locked, locked


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


def test_asking_writes_nothing(tmp_path: Path) -> None:
    assert not is_locked(tmp_path)
    assert not list(tmp_path.iterdir())
