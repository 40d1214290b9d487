"""The link between the scheduler and a worker is cut for ten seconds."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, closing, contextmanager
from pathlib import Path

import pytest

from study.config.settings import Engine
from study.workflow.lease import read_holder
from tests.helpers import link
from tests.helpers.chains import STAGE, journals, run_chains, tasks
from tests.helpers.cluster import LINKED, Cluster
from tests.helpers.link import Link, ProxyLink

CUT = 10.0
LEASE = 3


@contextmanager
def proxy() -> Iterator[Link]:
    """A link without privileges."""
    with closing(ProxyLink()) as made:
        yield made


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "worker_ttl"), [(link.link, 300.0), (link.link, 4.0), (proxy, 4.0)]
)
def test_a_cut_link_changes_no_byte(
    kind: Callable[[], AbstractContextManager[Link]], worker_ttl: float, tmp_path: Path
) -> None:
    """The scheduler waits for the worker, or gives it up."""
    alone, out, every = tmp_path / "alone", tmp_path / "out", tasks(0.5)
    assert run_chains(alone, Engine(kind="serial"), tasks(0.0)) == {}
    cut: list[str] = []
    with (
        kind() as made,
        Cluster(tmp_path / "cluster", 3, worker_ttl, link=made) as cluster,
    ):
        cluster.wait_for_workers(3)

        def disturb() -> None:
            """Cut the link while its worker runs a stage."""
            deadline = time.monotonic() + 60
            while not cut and time.monotonic() < deadline:
                for path in out.glob(f"work/{STAGE}/.*.lease"):
                    holder = read_holder(path)
                    if holder is not None and holder.process == cluster.workers[LINKED].pid:
                        cut.append(path.name)
                        made.cut_for(CUT)
                        return
                time.sleep(0.02)

        thread = threading.Thread(target=disturb)
        thread.start()
        began = time.monotonic()
        assert run_chains(out, Engine(address=cluster.address, lease=LEASE), every) == {}
        took = time.monotonic() - began
        thread.join()
    assert cut
    assert took > CUT or worker_ttl < CUT
    # The duration of a link is part of its key, and so of the names of folders.
    assert sorted(journals(out).values()) == sorted(journals(alone).values())
