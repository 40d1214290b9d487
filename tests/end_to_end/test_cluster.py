"""A study on an existing Dask scheduler has the bytes of the study in one process."""

from pathlib import Path

from tests.helpers.cluster import Cluster
from tests.helpers.running import SMALL, results, run


def test_a_cluster_gives_the_same_bytes(tmp_path: Path, small: Path) -> None:
    flags = [flag for flag in SMALL if not flag.startswith("--engine")]
    with Cluster(tmp_path / "cluster", workers=2) as cluster:
        cluster.wait_for_workers(2)
        done = run("all", *flags, *cluster.flags, "--out", tmp_path / "out")
    assert (done.code, done.err) == (0, "")
    assert f"14 stages to run, on the workers of {cluster.address}; " in done.out
    assert results(tmp_path / "out") == results(small)
