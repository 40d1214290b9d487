"""Rerun's viewer for browsers, from the installed package.

The package has no files of the web viewer: its program serves them. So the program is started on
the loopback interface, its files are copied into memory, and the program is stopped.
"""

import os
import re
import subprocess
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from urllib.error import URLError
from urllib.request import ProxyHandler, build_opener

from study.common.errors import StudyError
from study.recording.viewer import LOCALHOST, executable

FILES = {
    "index.html": "text/html; charset=utf-8",
    "re_viewer.js": "text/javascript",
    "re_viewer_bg.wasm": "application/wasm",
    "favicon.ico": "image/x-icon",
}
"""The files of the web viewer, with their types."""
PATIENCE = 60.0
"""Seconds to wait for the program."""
_ADDRESS = re.compile(rf"Hosting a web-viewer at (http://{re.escape(LOCALHOST)}:\d+)")
_REMOTE = re.compile(r"<link\b[^>]*\bhttps?://[^>]*>", re.DOTALL)
_OWN = build_opener(ProxyHandler({}))
"""Opens addresses of this machine without a proxy."""


@dataclass(frozen=True)
class WebFile:
    """A file of the web viewer."""

    content: bytes
    media_type: str


def web_viewer() -> Mapping[str, WebFile]:
    """The files of the web viewer, by name. Links to fonts of other servers are removed.

    Raises:
        StudyError: the program does not start, or does not serve a file.
    """
    command = [executable(), "--serve-web", "--bind", LOCALHOST]
    command += ["--web-viewer-port", "0", "--port", "auto"]
    # The address stands in the log, which the environment of a study reduces to errors.
    environment = os.environ | {"RUST_LOG": "info"}
    with TemporaryDirectory() as folder, open(Path(folder) / "log", "wb") as log:
        process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=log, stderr=subprocess.STDOUT, env=environment
        )
        try:
            address = _address(process, Path(log.name))
            return {name: _read(address, name) for name in FILES}
        finally:
            process.kill()
            process.wait()


def _address(process: "subprocess.Popen[bytes]", log: Path) -> str:
    """The address of the program, from its log."""
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end and process.poll() is None:
        if found := _ADDRESS.search(log.read_text(encoding="utf-8", errors="replace")):
            return found[1]
        time.sleep(0.05)
    lines = log.read_text(encoding="utf-8", errors="replace").strip().splitlines() or ["no output"]
    raise StudyError(f"Rerun does not serve its web viewer: {lines[-1]}")


def _read(address: str, name: str) -> WebFile:
    try:
        with _OWN.open(f"{address}/{name}", timeout=PATIENCE) as response:
            content: bytes = response.read()
    except (URLError, TimeoutError, OSError) as error:
        raise StudyError(f"Rerun's web viewer has no {name}: {error}") from None
    if name == "index.html":
        content = _REMOTE.sub("", content.decode()).encode()
    return WebFile(content, FILES[name])
