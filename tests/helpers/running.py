"""Running the study in tests: in this process, or in one of its own; and comparing what it left."""

import io
import os
import signal
import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path

from study.commands.parser import CONFIGS
from study.common.files import sha256
from study.run import main

ROOT = CONFIGS.parent
SMOKE = ["--config", str(CONFIGS / "smoke.yaml")]
# Two environments of our own are known (`cart`, and `quicksand`, which can fail); one is used.
SMALL = [
    *SMOKE,
    "--plugins=[study.examples.cart, tests.helpers.quicksand]",
    "--grid.environments=[cart]",
    "--grid.levels=[low]",
    "--grid.models=[full_vae, drift]",
    "--tune.trials=4",
    "--engine.kind=serial",
]


@dataclass(frozen=True)
class Done:
    """How a command ended, and what it said."""

    code: int
    out: str
    err: str

    def due(self) -> dict[str, str]:
        """Of a `plan`: why each stage that has to run has to, by `stage label`."""
        lines = [line.split(maxsplit=2) for line in self.out.splitlines()[:-1]]
        return {f"{stage} {label}": why for stage, label, why in lines if why != "up to date"}


def study(*arguments: object) -> Done:
    """Run a command in this process."""
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        code = main(list(map(str, arguments)))
    return Done(code, out.getvalue(), err.getvalue())


def start(*arguments: object, **environment: str) -> "subprocess.Popen[str]":
    """Start a command in a process of its own, which leads a group of its own."""
    return subprocess.Popen(
        [sys.executable, "-m", "study.run", *map(str, arguments)],
        cwd=ROOT,
        env=os.environ | environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=_hear_interrupts,
    )


def _hear_interrupts() -> None:
    """Where the tests run in the background a shell has them ignore Ctrl-C, and their children."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def run(*arguments: object, **environment: str) -> Done:
    """Run a command in a process of its own."""
    process = start(*arguments, **environment)
    out, err = process.communicate()
    return Done(process.returncode, out, err)


def files(out: Path, *patterns: str) -> dict[str, str]:
    """The SHA-256 of the files of a results folder, by name."""
    return {
        str(path.relative_to(out)): sha256(path)
        for pattern in patterns or ("**/*",)
        for path in out.glob(pattern)
        if path.is_file() and path.name != ".lock"
    }


def results(out: Path) -> dict[str, str]:
    """Those files that are byte for byte the same whenever and however the study was run."""
    names = ("*.parquet", "claims.*", "study.json", "tables/*", "weights/**/*")
    return files(out, *names, "illustrations/**/*")


def published(out: Path) -> dict[str, str]:
    """What a reader of the results opens."""
    names = ("*.parquet", "claims.*", "study.json", "tables/*", "figures/*")
    return files(out, *names, "weights/**/*", "illustrations/**/*", "recordings/**/*")
