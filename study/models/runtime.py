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

_uses: dict[str, str] = {}
"""The devices that the current task has used, and their precision in training."""


def runtime() -> Mapping[str, Any]:
    """The versions of Python and of packages, the device, the C compiler, and torch's threads.

    The result is JSON, and is written into the manifest of the task. The tasks of a run may differ
    by the GPU.
    """
    return {
        "versions": versions(),
        "device": _device(),
        "compiler": _compiler(),
        "threads": torch.get_num_threads(),
    }


def report_use(device: torch.device, precision: str = "32") -> None:
    """Report that the current task fits or forecasts on a device."""
    _uses[device.type] = precision


def forget_uses() -> None:
    """Begin a new task."""
    _uses.clear()


def uses() -> str:
    """The devices of the current task, such as `cpu`, `cpu bf16` or `cuda`."""
    return ", ".join(
        device if precision == "32" else f"{device} {precision}"
        for device, precision in sorted(_uses.items())
    )


def _device() -> str:
    """The processor; and if the current task has used them, the GPU and bfloat16."""
    parts = [_processor()]
    if "cuda" in _uses:
        parts.append(torch.cuda.get_device_name())
    if "bf16" in _uses.values():
        parts.append("bfloat16")
    return ", ".join(parts)


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
