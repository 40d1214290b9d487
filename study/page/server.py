"""A server for the page and the recordings of a study, for a browser on this machine.

It listens on the loopback interface alone and writes nothing. Every address starts with a random
token, so that other users of the machine and other pages in the browser cannot guess it. The Host
header must name this server, so that no name of another host can stand for it (DNS rebinding).
"""

import hmac
import secrets
from collections.abc import Callable, Mapping
from functools import cached_property
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Lock
from typing import Any
from urllib.parse import parse_qs, quote, unquote, urlsplit

from study.common.errors import BadInput, StudyError, explain
from study.page.write import NAME, render_folder
from study.recording.tabs import Layout
from study.recording.viewer import LOCALHOST
from study.recording.web_viewer import WebFile, web_viewer
from study.results import checksums

VIEWER = "viewer"
LAYOUTS = "layouts"
"""Address of the layouts of recordings that open a tab: layouts/TAB/NAME.rbl."""
PUBLIC = {NAME, "README.md", "ablations.json", checksums.NAME, *checksums.FILES, *checksums.FOLDERS}
"""The files and folders of a results folder that are served."""
TYPES = {
    ".html": "text/html; charset=utf-8",
    ".json": "application/json",
    ".md": "text/plain; charset=utf-8",
    ".pdf": "application/pdf",
    ".png": "image/png",
    ".rbl": "application/octet-stream",
    ".tex": "text/plain; charset=utf-8",
}
HEADERS = {
    "Cache-Control": "no-store",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
}
"""Headers of every answer. The address has the token, so no other server may learn it."""
VIEWER_POLICY = (
    "default-src 'self' blob: data:; script-src 'self' 'unsafe-inline' 'wasm-unsafe-eval'; "
    "style-src 'self' 'unsafe-inline'; worker-src 'self' blob:"
)
"""Content security of the viewer: it may connect to this server only."""


class Server(ThreadingHTTPServer):
    """Serves one results folder at `address`."""

    daemon_threads = True

    def __init__(
        self,
        out: Path,
        port: int = 0,
        page: Callable[[Path], str] = render_folder,
        viewer: Callable[[], Mapping[str, WebFile]] = web_viewer,
    ) -> None:
        """Listen on a port of the loopback interface.

        Args:
            out: the results folder.
            port: 0 for a free one.
            page: makes the page of a folder.
            viewer: loads the files of the web viewer.

        Raises:
            BadInput: the port cannot be used.
        """
        self.out = out.resolve()
        self.token = secrets.token_urlsafe(18)
        self._make_page, self._load_viewer = page, viewer
        self._lock = Lock()
        try:
            super().__init__((LOCALHOST, port), Handler)
        except (OSError, OverflowError) as error:
            reason = explain(error) if isinstance(error, OSError) else str(error)
            raise BadInput(f"--port: cannot listen on {port}: {reason}; give another") from None

    @property
    def hosts(self) -> set[str]:
        """The Host headers that name this server."""
        return {f"{name}:{self.server_port}" for name in (LOCALHOST, "localhost")}

    @property
    def address(self) -> str:
        """The address of the page."""
        return f"http://{LOCALHOST}:{self.server_port}/{self.token}/"

    @cached_property
    def page(self) -> bytes:
        """The page, made once for all requests."""
        return self._make_page(self.out).encode()

    @cached_property
    def viewer(self) -> Mapping[str, WebFile]:
        """The files of the web viewer, loaded once."""
        return self._load_viewer()

    def content(self, name: str) -> WebFile | None:
        """The content at a path below the token; None if there is none.

        Raises:
            StudyError: the page or the viewer cannot be made.
            OSError: a file cannot be read.
        """
        with self._lock:
            if name in ("", NAME):
                return WebFile(self.page, TYPES[".html"])
            if name == f"{VIEWER}/":
                return self.viewer["index.html"]
            if name.startswith(f"{VIEWER}/"):
                return self.viewer.get(name.removeprefix(f"{VIEWER}/"))
        if name.startswith(f"{LAYOUTS}/"):
            return self._layout(name.removeprefix(f"{LAYOUTS}/"))
        path = self._file(name)
        if path is None:
            return None
        return WebFile(path.read_bytes(), TYPES.get(path.suffix, "application/octet-stream"))

    def _layout(self, name: str) -> WebFile | None:
        """The layout of a recording with a tab open; None if there is no such tab."""
        tab, _, rest = name.partition("/")
        path = self._file(rest.removesuffix(".rbl") + ".rrd")
        if path is None or not rest.endswith(".rbl") or not _is_number(tab):
            return None
        layout = Layout(path)
        if int(tab) >= len(layout.tabs):
            return None
        return WebFile(layout.opened(int(tab)), TYPES[".rbl"])

    def _file(self, name: str) -> Path | None:
        """A file of the study; None outside the folder, for hidden files and other files."""
        parts = name.split("/")
        if parts[0] not in PUBLIC or any(part.startswith(".") or not part for part in parts):
            return None
        try:
            path = (self.out / name).resolve()
            inside = path.is_relative_to(self.out) and path.is_file()
        except (OSError, ValueError):  # a name that no file can have
            return None
        return path if inside else None


class Handler(BaseHTTPRequestHandler):
    """Answers GET and HEAD."""

    server: Server
    server_version = "study"
    sys_version = ""
    timeout = 60

    def do_GET(self) -> None:
        """Answer with a file."""
        if self.headers.get("Host") not in self.server.hosts:
            self.send_error(HTTPStatus.MISDIRECTED_REQUEST, "another host")
            return
        name = self._name()
        if name is None:
            self.send_error(HTTPStatus.NOT_FOUND)
            return
        if name.endswith(".rrd") and self.headers.get("Sec-Fetch-Mode") == "navigate":
            self._open_in_viewer(name)
            return
        try:
            content = self.server.content(name)
        except (StudyError, OSError) as error:
            self.send_error(HTTPStatus.INTERNAL_SERVER_ERROR, explain=str(error))
            return
        if content is None:
            self.send_error(HTTPStatus.NOT_FOUND)
            return
        self.send_response(HTTPStatus.OK)
        self.send_header("Content-Type", content.media_type)
        self.send_header("Content-Length", str(len(content.content)))
        if name.startswith(f"{VIEWER}/"):
            self.send_header("Content-Security-Policy", VIEWER_POLICY)
        self.end_headers()
        if self.command == "GET":
            self.wfile.write(content.content)

    do_HEAD = do_GET

    def do_POST(self) -> None:
        """Refuse to change anything."""
        self.send_error(HTTPStatus.METHOD_NOT_ALLOWED)

    do_PUT = do_DELETE = do_PATCH = do_OPTIONS = do_POST

    def end_headers(self) -> None:
        """Add the headers of every answer."""
        for name, value in HEADERS.items():
            self.send_header(name, value)
        super().end_headers()

    def log_message(self, format: str, *args: Any) -> None:
        """Keep the terminal quiet."""

    def _name(self) -> str | None:
        """The path below the token; None if the token is wrong or the path leaves the folder."""
        path = unquote(urlsplit(self.path).path, errors="replace")
        token, slash, name = path.removeprefix("/").partition("/")
        if not slash or not hmac.compare_digest(token.encode(), self.server.token.encode()):
            return None
        bad = "\\" in name or "\0" in name or any(part in (".", "..") for part in name.split("/"))
        return None if bad else name

    def _open_in_viewer(self, name: str) -> None:
        """Send a browser that follows a link to a recording to the viewer.

        A link with `?tab=NUMBER` opens this tab. Of several layouts the viewer uses the first.
        """
        names = [name]
        (tab,) = parse_qs(urlsplit(self.path).query).get("tab", [""])[:1]
        if _is_number(tab):
            names.insert(0, f"{LAYOUTS}/{tab}/{name.removesuffix('.rrd')}.rbl")
        addresses = [quote(f"{self.server.address}{quote(part)}", safe="") for part in names]
        query = "&".join(f"url={address}" for address in addresses)
        self.send_response(HTTPStatus.SEE_OTHER)
        self.send_header("Location", f"/{self.server.token}/{VIEWER}/?{query}")
        self.send_header("Content-Length", "0")
        self.end_headers()


def _is_number(text: str) -> bool:
    return text.isascii() and text.isdigit() and len(text) < 4
