"""Run commands in tests, in this process or another, and compare the files of results folders."""

import io
import os
import signal
import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path

from study.commands.parser import parse
from study.commands.settings import CONFIGS
from study.common.files import sha256
from study.config.settings import Config
from study.run import main

ROOT = CONFIGS.parent
SMOKE = ["--config", str(CONFIGS / "smoke.yaml")]
SMALL = [
    *SMOKE,
    "--plugins=[study.examples.cart, study.examples.drift, tests.helpers.quicksand]",
    "--grid.environments=[cart]",
    "--grid.levels=[low]",
    "--grid.models=[full_vae, drift]",
    "--tune.trials=4",
    "--engine.kind=serial",
]


"""A study of one environment, that of the tutorial, in this process. The environment `quicksand`,
whose stages can fail, is registered as well."""


@dataclass(frozen=True)
class Done:
    """The exit code and the output of a command."""

    code: int
    out: str
    err: str

    def due(self) -> dict[str, str]:
        """From the output of `plan`: why each stage has to run, by `stage label`."""
        lines = [line.split(maxsplit=2) for line in self.out.splitlines()[:-1]]
        return {f"{stage} {label}": why for stage, label, why in lines if why != "up to date"}


def configuration(*flags: str) -> Config:
    """The settings that a command line gives."""
    _, options = parse(["all", *flags])
    config: Config = options.config
    return config


def study(*arguments: object) -> Done:
    """Run a command in this process."""
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        code = main(list(map(str, arguments)))
    return Done(code, out.getvalue(), err.getvalue())


def start(*arguments: object, **environment: str) -> "subprocess.Popen[str]":
    """Start a command in another process, which leads a group of processes."""
    return subprocess.Popen(
        [sys.executable, "-m", "study.run", *map(str, arguments)],
        cwd=ROOT,
        env=os.environ | environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=_restore_interrupts,
    )


def _restore_interrupts() -> None:
    """A shell starts background processes, and so the tests, with Ctrl-C ignored."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def run(*arguments: object, **environment: str) -> Done:
    """Run a command in another process."""
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
    """The files whose bytes do not depend on when and how the study was run."""
    names = ("*.parquet", "claims.*", "study.json", "tables/*", "weights/**/*")
    return files(out, *names, "illustrations/**/*")


def published(out: Path) -> dict[str, str]:
    """The files that a reader of the results opens."""
    names = ("*.parquet", "claims.*", "study.json", "tables/*", "figures/*")
    return files(out, *names, "weights/**/*", "illustrations/**/*", "recordings/**/*")
