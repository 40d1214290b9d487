"""Runs on an existing Dask scheduler, with workers in processes and folders of their own."""

import os
import shutil
import signal
import socket
import subprocess
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from study.common.errors import BadInput
from study.config.settings import Engine
from study.workflow.cluster import GPU, accelerator
from study.workflow.engine import start
from study.workflow.fitness import SHARED, Expected, why_unfit
from study.workflow.lease import read_holder
from study.workflow.store import Store
from study.workflow.task import Task
from tests.helpers.chains import STAGE, journals, run_chains, tasks
from tests.helpers.cluster import Cluster

LEASE, WORKER_TTL = 3, 4.0


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    with Cluster(tmp_path_factory.mktemp("cluster"), 3, WORKER_TTL) as started:
        started.wait_for_workers(3)
        yield started


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """The files of the chains, run in this process."""
    out = tmp_path_factory.mktemp("undisturbed")
    assert run_chains(out, Engine(kind="serial"), tasks(0.0)) == {}
    return journals(out)


def _engine(cluster: Cluster) -> Engine:
    return Engine(kind="dask", address=cluster.address, lease=LEASE)


@pytest.mark.slow
def test_a_killed_and_a_stopped_worker_cost_their_stages(
    cluster: Cluster, undisturbed: dict[str, str], tmp_path: Path
) -> None:
    """The bytes are those of an undisturbed run, and the stopped worker writes nothing."""
    every, store = tasks(0.6), Store(tmp_path.resolve() / "work")
    disturbed: list[int] = []

    def disturb() -> None:
        """Kill the first worker that runs a stage, and stop the next."""
        deadline = time.monotonic() + 60
        while len(disturbed) < 2 and time.monotonic() < deadline:
            for path in store.root.glob(f"{STAGE}/.*.lease"):
                holder = read_holder(path)
                pids = [process.pid for process in cluster.workers.values()]
                if holder is None or holder.process in disturbed or holder.process not in pids:
                    continue
                os.kill(holder.process, signal.SIGSTOP if disturbed else signal.SIGKILL)
                disturbed.append(holder.process)
                break
            time.sleep(0.05)

    thread = threading.Thread(target=disturb)
    thread.start()
    try:
        assert run_chains(tmp_path, _engine(cluster), every) == {}
    finally:
        thread.join()
        for process in disturbed[1:]:
            os.kill(process, signal.SIGCONT)
    assert len(disturbed) == 2
    expected = sorted(undisturbed.values())
    assert sorted(journals(tmp_path).values()) == expected
    cluster.wait_for_end(disturbed[1])
    assert sorted(journals(tmp_path).values()) == expected
    assert not list(store.root.glob(f"{STAGE}/.*"))


@pytest.mark.slow
def test_an_error_of_a_stage_is_not_tried_again(cluster: Cluster, tmp_path: Path) -> None:
    errors = run_chains(tmp_path, _engine(cluster), tasks(0.0, broken=2))
    assert errors.pop("chain-2/1") == "ValueError: this link is broken"
    assert all(error.startswith("not run: ") for error in errors.values())
    assert len(journals(tmp_path)) == 18 - 1 - len(errors)
    # The folder of a failed stage stays for a look, and its lease does not.
    assert not list(tmp_path.glob(f"work/{STAGE}/.*.lease"))


def test_no_scheduler_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{free.getsockname()[1]}"
    monkeypatch.setenv("DASK_DISTRIBUTED__COMM__TIMEOUTS__CONNECT", "500ms")
    with pytest.raises(BadInput, match=f"no Dask scheduler answers at {address} "):
        start(Engine(address=address), tmp_path, []).__enter__()


def test_certificates_are_named(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match=r"certificates in Dask's settings, distributed\.comm\.tls"):
        start(Engine(address="tls://127.0.0.1:8786"), tmp_path, []).__enter__()


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("openssl") is None, reason="openssl makes the certificate")
def test_certificates_of_dasks_settings_are_used(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    command = "openssl req -x509 -newkey rsa:2048 -nodes -days 1 -subj /CN=localhost"
    pair = ["-keyout", f"{tmp_path}/key.pem", "-out", f"{tmp_path}/cert.pem"]
    subprocess.run([*command.split(), *pair], check=True, capture_output=True)
    variables = {"CA_FILE": "cert", "CLIENT__CERT": "cert", "CLIENT__KEY": "key"}
    for part in ("SCHEDULER", "WORKER"):
        variables |= {f"{part}__CERT": "cert", f"{part}__KEY": "key"}
    for name, file in variables.items():
        monkeypatch.setenv(f"DASK_DISTRIBUTED__COMM__TLS__{name}", f"{tmp_path}/{file}.pem")
    (tmp_path / "store").mkdir()
    with Cluster(tmp_path / "cluster", 1, protocol="tls") as cluster:
        assert cluster.address.startswith("tls://")
        cluster.wait_for_workers(1)
        with start(_engine(cluster), tmp_path / "store", []) as workers:
            assert workers.capacity() == {"": 1}
            assert workers.submit(_name_of_worker, Task("record", "a", {})).result(60) == 0


@pytest.mark.slow
def test_a_worker_of_several_tasks_is_one_line(cluster: Cluster, tmp_path: Path) -> None:
    cluster.start_worker(9, "--nthreads=2")
    cluster.wait_for_workers(len(cluster.alive()))
    try:
        with pytest.raises(BadInput, match="it runs 2 tasks in one process") as caught:
            start(_engine(cluster), tmp_path, []).__enter__()
        assert "\n" not in str(caught.value)
        assert not list(tmp_path.iterdir())
    finally:
        cluster.stop_worker(9)


def _expected(root: Path) -> Expected:
    (root / SHARED).write_text("token")
    return Expected.here(root, (), "token")


def test_a_worker_with_the_same_source_packages_and_folder_is_fit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("study.workflow.fitness.NUMPY_THREADS", "1")
    assert why_unfit(_expected(tmp_path), 1) is None
    assert [path.name for path in tmp_path.iterdir()] == [SHARED]


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"source": "another"}, "it has another version of the study"),
        ({"packages": {"torch": "1.0"}}, "and this process 1.0; install 1.0"),
        ({"plugins": {"mine": "changed"}, "plugin_modules": ()}, "its plugins  differ"),
        ({"token": "of another folder"}, "is another folder; mount the shared one"),
        ({"root": Path("/nowhere")}, "it does not see /nowhere on "),
    ],
)
def test_why_a_worker_is_unfit(
    change: dict[str, Any], why: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("study.workflow.fitness.NUMPY_THREADS", "1")
    answer = why_unfit(replace(_expected(tmp_path), **change), 1)
    assert answer is not None
    assert why in answer
    assert "\n" not in answer


def test_numpy_with_several_threads_is_unfit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("study.workflow.fitness.HAD_NUMPY", True)
    monkeypatch.setattr("study.workflow.fitness.NUMPY_THREADS", None)
    assert "start it with OMP_NUM_THREADS=1" in str(why_unfit(_expected(tmp_path), 1))


@pytest.mark.parametrize("wanted", ["auto", "cpu", "gpu"])
def test_fits_ask_for_their_accelerator(wanted: str) -> None:
    fit = {"model_settings": {"train": {"accelerator": wanted}}}
    assert accelerator(Task("train", "a", fit)) == wanted
    assert accelerator(Task("tune", "a", {"fit": fit})) == wanted
    assert accelerator(Task("trial", "a", {"fit": fit})) == wanted
    ensemble = Task("ensemble", "a", {"accelerator": wanted})
    assert accelerator(ensemble) == wanted
    for stage in ("evaluate", "validate"):
        forecast = Task(stage, "a", {"accelerator": wanted}, {"trained": ensemble})
        assert accelerator(forecast) == ("gpu" if wanted == "gpu" else None)


def test_what_has_no_setting_asks_for_no_accelerator() -> None:
    assert accelerator(Task("ensemble", "a", {})) == "auto"
    assert accelerator(Task("collect", "a", {})) is None
    assert accelerator(Task("evaluate", "a", {})) is None
    assert accelerator(Task("evaluate", "oracle", {"accelerator": "gpu"})) is None


@pytest.mark.slow
def test_a_gpu_is_asked_for_where_a_worker_offers_one(cluster: Cluster, tmp_path: Path) -> None:
    fit = {"model_settings": {"train": {"accelerator": "gpu"}}}
    train, other = Task("train", "a", fit), Task("evaluate", "a", {})
    with pytest.raises(BadInput, match=r"got 'gpu', and no worker of tcp://.* offers one"):
        start(_engine(cluster), tmp_path, [train]).__enter__()
    before = len(cluster.alive())
    cluster.start_worker(8, "--resources", f"{GPU}=1")
    cluster.wait_for_workers(before + 1)
    try:
        with start(_engine(cluster), tmp_path, [train]) as workers:
            assert workers.capacity() == {"": before + 1, GPU: 1}
            assert (workers.resource(train), workers.resource(other)) == (GPU, "")
            run_on = workers.submit(_name_of_worker, train)
            assert run_on.result(timeout=60) == 8
    finally:
        cluster.stop_worker(8)


def _name_of_worker(task: Task) -> object:
    from distributed import get_worker

    return get_worker().name
