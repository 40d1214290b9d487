"""Stand-ins of ``sbatch``, ``squeue`` and ``scancel``: jobs are local processes.

A job has a folder with its script, its number of process, and, when it has ended, its exit code. A
job ends at its walltime: SIGTERM to its processes, SIGKILL two seconds later, exit code 124. Memory
and partitions are not enforced.
"""

import os
import re
import signal
import stat
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

PROGRAMS = ("sbatch", "squeue", "scancel")
ENDED_AT_WALLTIME = ("124", "137")


class Slurm:
    """The programs, in a folder to be put into ``PATH``, and their jobs."""

    def __init__(self, folder: Path) -> None:
        self.programs, self.jobs = folder / "bin", folder / "jobs"
        self.jobs.mkdir()
        self.programs.mkdir()
        for name in PROGRAMS:
            program = self.programs / name
            call = f'exec {sys.executable} {Path(__file__)} {name} {self.jobs} "$@"'
            program.write_text(f"#!/bin/sh\n{call}\n", encoding="utf-8")
            program.chmod(program.stat().st_mode | stat.S_IXUSR)

    @property
    def path(self) -> str:
        """``PATH`` with the programs."""
        return f"{self.programs}{os.pathsep}{os.environ['PATH']}"

    def scripts(self) -> list[str]:
        """The script of every job, in the order of submission."""
        folders = sorted(self.jobs.iterdir(), key=lambda path: int(path.name))
        return [(folder / "script").read_text(encoding="utf-8") for folder in folders]

    def exit_codes(self) -> list[str]:
        """The exit code of every job that has ended."""
        return [path.read_text(encoding="utf-8").strip() for path in self.jobs.glob("*/exit")]

    def running(self) -> list[str]:
        """The numbers of the jobs that run."""
        return [path.name for path in self.jobs.iterdir() if _is_running(path)]

    def cancel_all(self) -> None:
        """End all jobs."""
        for path in self.jobs.iterdir():
            _cancel(path)


def _submit(jobs: Path, script: Path) -> None:
    text = script.read_text(encoding="utf-8")
    number = 1 + len(list(jobs.iterdir()))
    job = jobs / str(number)
    job.mkdir()
    (job / "script").write_text(text, encoding="utf-8")
    output = _directive(text, "-o").replace("%J", str(number))
    hours, minutes, seconds = map(int, _directive(text, "-t").split(":"))
    walltime = (60 * hours + minutes) * 60 + seconds
    command = f"timeout -k 2 {walltime} bash {job}/script; echo $? > {job}/exit"
    with Path(output).open("w", encoding="utf-8") as file:
        process = subprocess.Popen(
            ["sh", "-c", command],
            stdin=subprocess.DEVNULL,
            stdout=file,
            stderr=subprocess.STDOUT,
            env=os.environ | {"SLURM_JOB_ID": str(number), "SLURM_NTASKS": "1"},
            start_new_session=True,
        )
    (job / "process").write_text(str(process.pid), encoding="utf-8")
    print(f"Submitted batch job {number}")


def _directive(text: str, option: str) -> str:
    found = re.search(rf"^#SBATCH {option} (.*)$", text, re.MULTILINE)
    assert found, option
    return found[1]


def _is_running(job: Path) -> bool:
    return (job / "process").exists() and not (job / "exit").exists()


def _cancel(job: Path) -> None:
    """SIGTERM to the processes of the job, which are one session with two groups."""
    if not _is_running(job):
        return
    session = (job / "process").read_text(encoding="utf-8")
    (job / "exit").write_text("cancelled", encoding="utf-8")
    for path in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError, ProcessLookupError):
            fields = path.read_text(encoding="utf-8").rpartition(")")[2].split()
            if fields[3] == session:
                os.kill(int(path.parent.name), signal.SIGTERM)


def main(program: str, jobs: Path, arguments: list[str]) -> int:
    """Run a program."""
    if program == "sbatch":
        _submit(jobs, Path(arguments[-1]))
        return 0
    number = arguments[arguments.index("--job") + 1] if "--job" in arguments else arguments[-1]
    if not (jobs / number).is_dir():
        print(f"{program}: error: Invalid job id specified", file=sys.stderr)
        return 1
    if program == "scancel":
        _cancel(jobs / number)
    elif _is_running(jobs / number):
        print("RUNNING")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], Path(sys.argv[2]), sys.argv[3:]))
