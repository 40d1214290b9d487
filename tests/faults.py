"""Disturb runs on a Dask cluster: ``python -m tests.faults --seed 0 --disturbances 100``.

A scheduler and three workers, each a process with a working folder of its own, run a study on a
shared folder. At random moments, from a seed, one of these happens:

- *worker killed*: SIGKILL; another worker starts in its place.
- *worker stopped*: SIGSTOP until its lease ends, then SIGCONT.
- *scheduler killed*: SIGKILL; another one starts at the same address.
- *run killed*: SIGKILL of the main process.
- *link cut*: the one between the scheduler and a worker, for ten seconds (`tests.helpers.link`).
- *disk full*: the folder for temporary files of one worker, a small tmpfs. It needs root.
- *file damaged*: one bit of a complete stage is changed while no stage runs.

A run that ends before its study is complete is started again by the same command. At last the
files must be the bytes of an undisturbed run in one process. With ``--study chains`` the stages
sleep (`tests.helpers.chains`); ``--study small`` is a small study with training and a search in
batches, of which scores, weights and claims are compared.
"""

import argparse
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from study.workflow.lease import read_holder
from tests.helpers import chains
from tests.helpers.cluster import LINKED, Cluster, kill
from tests.helpers.link import Link
from tests.helpers.link import link as make_link
from tests.helpers.running import ROOT, SMALL, results

LEASE, WORKER_TTL = 4, 6.0
"""Seconds of a lease, and seconds after which the scheduler gives up a worker."""
LONGEST_START = 60.0
"""Seconds to wait for a stage to run before a disturbance, at most."""
LONGEST = 900.0
"""Seconds for a study to end when it is no longer disturbed."""
TMPFS = 2**21
CUT = 10.0
"""Seconds for which a link is cut."""
WITHOUT_ENGINE = [flag for flag in SMALL if not flag.startswith("--engine")] + ["--tune.batch=2"]


class Faults:
    """A cluster, a study on it, and the disturbances.

    Args:
        folder: of everything.
        name: of the study, `chains` or `small`.
        chance: the random numbers.
        link: between the scheduler and one worker.
    """

    def __init__(self, folder: Path, name: str, chance: random.Random, link: Link) -> None:
        self.folder, self.name, self.chance = folder, name, chance
        self.out, self.link = folder / "out", link
        self.full = folder / "full"
        self.counts: Counter[str] = Counter()
        self.runs = 0
        environment = {"TMPDIR": str(folder)}
        self.cluster = Cluster(folder / "cluster", 0, WORKER_TTL, environment, link=link)
        self.port = self.cluster.address.rpartition(":")[2]
        self.has_tmpfs = _mount(self.full)
        for worker in range(3):
            self.start_worker(worker)
        self.run = self.start_run()

    def close(self) -> None:
        """End all processes."""
        kill(self.run)
        self.cluster.__exit__(None, None, None)
        if self.has_tmpfs:
            subprocess.run(["umount", "--lazy", str(self.full)], check=True)

    def start_worker(self, worker: int) -> None:
        """Start a worker; the first has its temporary files in the small tmpfs."""
        own = self.full if worker == 0 and self.has_tmpfs else self.folder
        self.cluster.start_worker(worker, TMPDIR=str(own))

    def start_run(self) -> "subprocess.Popen[bytes]":
        """Start the study, or go on with it."""
        self.runs += 1
        command = [sys.executable, "-m", *command_of(self.name, self.out, self.cluster.address)]
        with (self.folder / "runs.log").open("ab") as output:
            return subprocess.Popen(
                command, cwd=ROOT, stdout=output, stderr=output, start_new_session=True
            )

    def continue_run(self) -> None:
        """Start ended processes again, and the run with them."""
        for worker, process in self.cluster.workers.items():
            if process.poll() is not None:
                self.start_worker(worker)
        if self.run.poll() not in (None, 0):
            self.run = self.start_run()

    def wait_for_a_stage(self) -> None:
        """Wait until a worker runs a stage, or the run ends; workers take a while to start."""
        deadline = time.monotonic() + LONGEST_START
        while self.run.poll() is None and time.monotonic() < deadline:
            holders = map(read_holder, self.out.glob("work/*/.*.lease"))
            if any(holder is not None and not holder.has_ended for holder in holders):
                return
            time.sleep(0.1)

    def disturb(self) -> str:
        """One disturbance, by chance; returns what happened."""
        kinds: list[Callable[[], str]] = [
            self.kill_worker, self.kill_worker, self.stop_worker, self.kill_scheduler,
            self.kill_run, self.damage_file, self.cut_link,
        ]  # fmt: skip
        if self.has_tmpfs:
            kinds.append(self.fill_disk)
        kind = self.chance.choice(kinds)
        self.counts[kind.__name__] += 1
        return kind()

    def kill_worker(self) -> str:
        """SIGKILL of a worker, in whose place another one starts."""
        worker = self.chance.randrange(3)
        lost = self.stages_of(self.cluster.workers[worker].pid)
        kill(self.cluster.workers[worker])
        self.start_worker(worker)
        return f"worker {worker} killed; lost {lost}"

    def stop_worker(self) -> str:
        """SIGSTOP of a worker until its lease has ended and others have gone on, then SIGCONT."""
        worker = self.chance.randrange(3)
        process = self.cluster.workers[worker]
        lost = self.stages_of(process.pid)
        with suppress(ProcessLookupError):
            os.kill(process.pid, signal.SIGSTOP)
            time.sleep(WORKER_TTL + 2 * LEASE)
            os.kill(process.pid, signal.SIGCONT)
        return f"worker {worker} stopped for {WORKER_TTL + 2 * LEASE:.0f} s; lost {lost}"

    def cut_link(self) -> str:
        """Cut the link of a worker for so long that the scheduler gives the worker up."""
        lost = self.stages_of(self.cluster.workers[LINKED].pid)
        self.link.cut_for(CUT)
        return f"link of worker {LINKED} cut for {CUT:.0f} s; it ran {lost}"

    def kill_scheduler(self) -> str:
        """SIGKILL of the scheduler; another one starts at the same address."""
        kill(self.cluster.scheduler)
        time.sleep(1)
        self.cluster.start_scheduler(int(self.port))
        return "scheduler killed"

    def kill_run(self) -> str:
        """SIGKILL of the main process."""
        kill(self.run)
        return "run killed"

    def fill_disk(self) -> str:
        """Fill the small tmpfs for a while."""
        filler = self.full / "filler"
        with suppress(OSError):
            filler.write_bytes(bytes(TMPFS))
        time.sleep(3)
        filler.unlink(missing_ok=True)
        return "disk of worker 0 full for 3 s"

    def damage_file(self) -> str:
        """Change a bit of a complete stage, while no run and no worker reads it."""
        kill(self.run)
        for process in self.cluster.workers.values():
            kill(process)
        files = sorted(
            path
            for path in self.out.glob("work/*/[!.]*/*")
            if path.is_file() and path.name != "timing.json"
        )
        if not files:
            return "run and workers killed; no file to damage"
        path = self.chance.choice(files)
        content = bytearray(path.read_bytes())
        content[self.chance.randrange(len(content))] ^= 1
        path.write_bytes(content)
        return f"run and workers killed, {path.relative_to(self.out)} damaged"

    def stages_of(self, process: int) -> str:
        """The stages for which a process holds leases."""
        holders = {path: read_holder(path) for path in self.out.glob("work/*/.*.lease")}
        stages = [
            f"{path.parent.name} {path.name.strip('.')[:8]}"
            for path, holder in holders.items()
            if holder is not None and holder.process == process
        ]
        return ", ".join(stages) or "nothing"


def command_of(name: str, out: Path, address: str) -> list[str]:
    """The module and the arguments that run a study; in one process if the address is empty."""
    if name == "chains":
        return ["tests.helpers.chains", str(out), address, str(LEASE)]
    engine = ["--engine.kind=serial"]
    if address:
        engine = ["--engine.kind=dask", f"--engine.address={address}", f"--engine.lease={LEASE}"]
    return ["study.run", "all", *WITHOUT_ENGINE, *engine, "--out", str(out)]


def bytes_of(name: str, out: Path) -> dict[str, str]:
    """The SHA-256 of the files that a disturbed run must have in common with another one."""
    return chains.journals(out) if name == "chains" else results(out)


def _mount(folder: Path) -> bool:
    """Mount a small tmpfs; returns whether this process may."""
    folder.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", f"size={TMPFS}", "tmpfs", str(folder)]
    with suppress(OSError):
        return subprocess.run(command, capture_output=True, check=False).returncode == 0
    return False


def disturb_study(
    folder: Path,
    name: str,
    most: int,
    pause: float,
    chance: random.Random,
    say: Callable[[str], None],
    link: Link,
) -> Counter[str]:
    """Run a study once, with disturbances until it is complete; returns their kinds."""
    faults = Faults(folder, name, chance, link)
    try:
        began, undisturbed = time.monotonic(), 0.0
        while faults.run.poll() != 0:
            if faults.counts.total() < most:
                faults.wait_for_a_stage()
                time.sleep(chance.uniform(0.0, pause))
                if faults.run.poll() == 0:
                    break
                what = faults.disturb()
                say(f"  {time.monotonic() - began:5.0f} s  {what}")
                undisturbed = time.monotonic()
            else:
                assert time.monotonic() - undisturbed < LONGEST, f"it hangs: see {folder}"
                time.sleep(0.5)
            faults.continue_run()
        say(f"  {time.monotonic() - began:5.0f} s  complete in {faults.runs} runs")
        left = [path for path in faults.out.glob("work/*/.*") if path.suffix != ".lease"]
        say(f"           temporary folders left: {len(left)}")
        return faults.counts
    finally:
        faults.close()


def main() -> int:
    """Disturb studies until there were as many disturbances as asked for; 1 if bytes differ."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--disturbances", type=int, default=100)
    parser.add_argument("--pause", type=float, default=6.0, help="longest, in seconds")
    parser.add_argument("--study", choices=("chains", "small"), default="chains")
    options = parser.parse_args()
    chance, counts, different = random.Random(options.seed), Counter[str](), 0

    def say(line: str) -> None:
        print(line, flush=True)

    with tempfile.TemporaryDirectory(prefix="faults-") as temporary, make_link() as link:
        folder = Path(temporary)
        reference = folder / "undisturbed"
        command = [sys.executable, "-m", *command_of(options.study, reference, "")]
        subprocess.run(command, cwd=ROOT, check=True, stdout=subprocess.DEVNULL)
        expected = bytes_of(options.study, reference)
        say(f"undisturbed, in one process: {len(expected)} files to compare")
        say(f"worker {LINKED} has a {type(link).__name__}")
        number = 0
        while counts.total() < options.disturbances:
            number += 1
            part = folder / f"study-{number}"
            part.mkdir()
            say(f"study {number}")
            most = options.disturbances - counts.total()
            counts += disturb_study(part, options.study, most, options.pause, chance, say, link)
            found = bytes_of(options.study, part / "out")
            differ = {name for name in expected | found if expected.get(name) != found.get(name)}
            different += len(differ)
            say(f"           {len(found)} files, {len(differ)} differ {sorted(differ)[:5] or ''}")
    say(f"{counts.total()} disturbances of {number} studies, seed {options.seed}:")
    for kind, count in sorted(counts.items()):
        say(f"  {count:3} {kind.replace('_', ' ')}")
    say(f"{different} files differ from the undisturbed run")
    return 1 if different else 0


if __name__ == "__main__":
    sys.exit(main())
