"""Workers in jobs of SLURM, with a stand-in that starts local processes and keeps the walltime."""

import os
import time
from collections.abc import Iterator
from concurrent.futures import wait
from pathlib import Path

import pytest

from study.common.errors import BadInput, StudyError
from study.config.settings import Engine
from study.workflow import slurm
from study.workflow.engine import start
from study.workflow.workers import Workers
from tests.helpers.running import SMALL, configuration, files, run, study
from tests.helpers.slurm_standin import ENDED_AT_WALLTIME, Slurm

pytest.importorskip("dask_jobqueue")


def _job_after(seconds: float) -> str:
    """On a worker: the number of its job, after a while."""
    time.sleep(seconds)
    return os.environ["JOB"]


def _wait_for_jobs(workers: Workers) -> None:
    while True:
        workers.capacity()
        time.sleep(0.2)


@pytest.fixture
def cluster(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Slurm]:
    """The stand-in, in ``PATH``."""
    (tmp_path / "slurm").mkdir()
    standin = Slurm(tmp_path / "slurm")
    monkeypatch.setenv("PATH", standin.path)
    yield standin
    standin.cancel_all()


@pytest.mark.slow
def test_jobs_are_asked_for_again_and_end_before_their_walltime(
    tmp_path: Path, cluster: Slurm, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Calls of two seconds follow one another until a second job has run one of them."""
    monkeypatch.setattr(slurm, "POLL", 0.5)
    engine = Engine(
        kind="slurm",
        walltime="00:00:24",
        partition="short",
        account="me",
        memory="3GB",
        directives=("--exclusive",),
        prologue=("export FROM_PROLOGUE=yes", "export JOB=$SLURM_JOB_ID"),
    )
    with start(engine, tmp_path, []) as workers:
        assert workers.capacity() == {"": 1}
        variable = workers.submit(os.getenv, "FROM_PROLOGUE")
        jobs = set[str]()
        while len(jobs) < 2:
            call = workers.submit(_job_after, 2)
            while wait([call], timeout=0.5).not_done:
                workers.capacity()
            if call.exception() is None:  # its worker was not lost
                jobs.add(call.result())
        assert variable.result() == "yes"
    assert jobs == {"1", "2"}
    scripts = cluster.scripts()
    for option in ("-p short", "-A me", "-t 00:00:24", "--mem=3G", "--cpus-per-task=1"):
        assert f"#SBATCH {option}\n" in scripts[0]
    assert "#SBATCH --exclusive\n" in scripts[0]
    assert not set(cluster.exit_codes()) & set(ENDED_AT_WALLTIME)
    assert not cluster.running()
    assert not list(tmp_path.glob("slurm/.dask*")), "a certificate is left"


@pytest.mark.slow
def test_cells_in_jobs_have_the_bytes_of_serial_ones(
    tmp_path: Path, small: Path, cluster: Slurm
) -> None:
    out = tmp_path / "results"
    flags = ["--only=cart/low/drift/*", "--engine.kind=slurm", "--engine.workers=2"]
    flags.append("--engine.cores=2")
    done = run("all", *SMALL, *flags, "--out", out, PATH=cluster.path)
    assert done.code == 0, done
    kinds = ("work/*/*/*.parquet", "work/train/*/model.safetensors", "weights/**/*")
    found = files(out, *kinds)
    assert {Path(name).suffix for name in found} == {".parquet", ".safetensors"}
    assert found.items() <= files(small, *kinds).items()
    assert len(cluster.scripts()) == 1  # of two workers
    assert not cluster.running()


@pytest.mark.slow
def test_jobs_that_end_before_a_worker_connects(
    tmp_path: Path, cluster: Slurm, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(slurm, "POLL", 0.1)
    engine = Engine(kind="slurm", prologue=("module load missing && exit 0", "exit 1"), retries=1)
    with start(engine, tmp_path, []) as workers:
        workers.submit(time.sleep, 0)
        with pytest.raises(StudyError, match="2 jobs of SLURM ended as soon as they"):
            _wait_for_jobs(workers)
    assert len(cluster.scripts()) == 2
    (output, *_) = (tmp_path / "slurm").glob("*.out")
    assert "module: command not found" in output.read_text()


def test_without_sbatch(tmp_path: Path) -> None:
    done = study("all", *SMALL, "--engine.kind", "slurm", "--out", tmp_path)
    assert done.code == 2
    assert "there is no sbatch here" in done.err
    assert len(done.err.splitlines()) == 1


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        (["--engine.walltime", "12"], "engine.walltime: got '12'; write hours as 12:00:00"),
        (["--engine.walltime", "00:00:10"], "at least 20 seconds"),
        (["--engine.memory", "8"], "engine.memory: got '8'; write a size of a job such as 8GB"),
        (["--engine.threads", "4"], "engine.cores: got 1; at least engine.threads, 4"),
    ],
)
def test_settings_that_cannot_be(flags: list[str], message: str) -> None:
    with pytest.raises(BadInput) as raised:
        configuration(*SMALL, "--engine.kind", "slurm", *flags)
    assert message in str(raised.value)
