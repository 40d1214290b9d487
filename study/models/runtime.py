"""The runtime on which results depend: versions, device, compiler and threads."""

import platform
import subprocess
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import torch

from study.common.provenance import versions
from study.models.unroll import compiler

PLAIN = "none: networks are unrolled in plain torch"


def runtime() -> Mapping[str, Any]:
    """The versions of Python and of packages, the device, the C compiler, and torch's threads.

    The result is JSON. It is the same for all tasks of a run, and is written into their manifests.
    """
    return {
        "versions": versions(),
        "device": _device(),
        "compiler": _compiler(),
        "threads": torch.get_num_threads(),
    }


def _device() -> str:
    """The processor, and the GPU if this process has used one."""
    if not torch.cuda.is_initialized():
        return _processor()
    return f"{_processor()}, {torch.cuda.get_device_name()}"


@cache
def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return f"{names[0] if names else platform.processor()} ({platform.machine()})"


@cache
def _compiler() -> str:
    """The first line of the C compiler's description of its version."""
    path = compiler.find()
    if path is None:
        return PLAIN
    try:
        process = subprocess.run([path, "--version"], capture_output=True, timeout=60, check=False)
    except (OSError, subprocess.SubprocessError):
        return PLAIN
    lines = process.stdout.decode(errors="replace").splitlines()
    return lines[0].strip() if lines else Path(path).name
