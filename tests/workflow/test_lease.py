"""Leases: one holder at a time, whatever happens to the process that holds one."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from study.workflow.lease import (
    Holder,
    Lease,
    LeaseInUse,
    LeaseLost,
    Terms,
    Watch,
    hold,
    read_holder,
    remove_abandoned,
)
from tests.helpers.running import ROOT

SHORT = Terms(seconds=1.0, run="a run")
HOLDER = """
import sys, time
from pathlib import Path
from study.workflow.lease import LeaseLost, Terms, hold
with hold(Path(sys.argv[1]), Terms(1.0, 3, "a run"), lambda holder: None) as lease:
    print("held", flush=True)
    try:
        while True:
            time.sleep(0.02)
            lease.check()
    except LeaseLost:
        print("lost", flush=True)
"""


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / ".stage.lease"


@pytest.fixture
def other(path: Path) -> Iterator["subprocess.Popen[str]"]:
    """Another process that holds the lease until it is lost."""
    process = subprocess.Popen(
        [sys.executable, "-c", HOLDER, str(path)], cwd=ROOT, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "held\n"
    yield process
    process.kill()
    process.wait()


def test_the_file_names_the_holder_and_goes_with_it(path: Path) -> None:
    with hold(path, SHORT) as lease:
        holder = read_holder(path)
        assert holder is not None
        assert (holder.process, holder.token, holder.attempt) == (os.getpid(), lease.token, 1)
        lease.verify()
    assert not list(path.parent.iterdir())


def test_a_holder_that_lives_keeps_the_lease(path: Path, other: "subprocess.Popen[str]") -> None:
    before = path.read_bytes()
    with pytest.raises(LeaseInUse, match=f"process {other.pid} on "):
        Lease(path, SHORT).take()
    time.sleep(1.5)
    assert path.read_bytes() == before


def test_a_killed_holder_is_followed_at_once(path: Path, other: "subprocess.Popen[str]") -> None:
    other.kill()
    other.wait()
    began = time.monotonic()
    with hold(path, replace(SHORT, seconds=1000.0)) as lease:
        assert time.monotonic() - began < 0.5
        assert lease.attempt == 2


def test_a_stopped_holder_loses_the_lease_and_knows_it_when_it_continues(
    path: Path, other: "subprocess.Popen[str]"
) -> None:
    os.kill(other.pid, signal.SIGSTOP)
    waited_for: list[Holder] = []
    with hold(path, SHORT, waited_for.append) as lease:
        assert [holder.process for holder in waited_for] == [other.pid]
        assert lease.attempt == 2
        os.kill(other.pid, signal.SIGCONT)
        assert other.communicate(timeout=30)[0] == "lost\n"
        lease.verify()
        holder = read_holder(path)
        assert holder is not None
        assert holder.token == lease.token


def test_another_machine_is_waited_for(path: Path) -> None:
    """Whether a process of another machine has ended is not known, so its lease must expire."""
    with hold(path, SHORT):
        content = path.read_text()
    system = content.index('"system": "') + len('"system": "')
    path.write_text(content[:system] + "elsewhere " + content[system:])
    began = time.monotonic()
    with hold(path, SHORT, lambda holder: None):
        assert time.monotonic() - began > SHORT.seconds


def test_a_lease_that_is_watched_expires_without_renewals(
    path: Path, other: "subprocess.Popen[str]"
) -> None:
    observed = Watch(path)
    time.sleep(1.5)
    assert not observed.has_expired()
    os.kill(other.pid, signal.SIGSTOP)  # as if its machine were lost
    assert not observed.has_expired()
    time.sleep(1.1)
    assert observed.has_expired()
    path.unlink()
    assert observed.has_expired()


def test_a_process_whose_new_file_is_removed_tries_again(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another process believes that this one was killed while it took the lease."""
    link, calls = os.link, []

    def remove_first(new: Path, target: Path) -> None:
        calls.append(new)
        if len(calls) == 1:
            remove_abandoned(path.parent, ".*.lease")
        link(new, target)

    monkeypatch.setattr(os, "link", remove_first)
    with hold(path, SHORT) as lease:
        lease.verify()
    assert len(calls) == 2


def test_attempts_of_another_run_do_not_count(path: Path, other: "subprocess.Popen[str]") -> None:
    other.kill()
    other.wait()
    with hold(path, replace(SHORT, run="another")) as lease:
        assert lease.attempt == 1


def test_a_lease_that_another_has_taken_and_released_is_lost(path: Path) -> None:
    with hold(path, SHORT) as lease:
        path.unlink()
        with pytest.raises(LeaseLost, match="was lost to another process"):
            lease.verify()
    assert not path.exists()


def test_a_lease_taken_by_another_is_neither_renewed_nor_removed(path: Path) -> None:
    with hold(path, SHORT) as lease:
        content = path.read_text().replace(lease.token, "other")
        path.unlink()
        path.write_text(content)
        with pytest.raises(LeaseLost, match=r"lost to process \d+ on "):
            lease.verify()
        modified = path.stat().st_mtime_ns
        time.sleep(0.5)
        assert path.stat().st_mtime_ns == modified
    assert path.read_text() == content
