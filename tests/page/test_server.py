"""The server of a page: this machine alone, one folder, nothing written."""

import http.client
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Thread
from urllib.parse import quote, urlsplit

import pytest

from study.common.errors import BadInput, StudyError
from study.config.names import FULL
from study.page.server import Server
from study.recording.forecast import record_forecast
from study.recording.web_viewer import FILES, WebFile, web_viewer
from tests.helpers import recordings
from tests.helpers.running import files

RECORDING = f"recordings/uav/low/{FULL}/seed-0/tuning.rrd"
VIEWER = {name: WebFile(name.encode(), kind) for name, kind in FILES.items()}


@contextmanager
def running(server: Server) -> Iterator[Server]:
    thread = Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
    thread.start()
    try:
        yield server
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


@pytest.fixture
def server(copy: Path) -> Iterator[Server]:
    with running(Server(copy, page=lambda out: "<p>the page", viewer=lambda: VIEWER)) as started:
        yield started


def ask(
    server: Server,
    path: str,
    method: str = "GET",
    host: str | None = None,
    headers: dict[str, str] | None = None,
) -> tuple[int, dict[str, str], bytes]:
    """Status, headers and content; the path is sent as it is, and is below the token."""
    connection = http.client.HTTPConnection("127.0.0.1", server.server_port, timeout=20)
    connection.putrequest(method, path, skip_host=True)
    connection.putheader("Host", host or f"127.0.0.1:{server.server_port}")
    for name, value in (headers or {}).items():
        connection.putheader(name, value)
    connection.endheaders()
    response = connection.getresponse()
    content = response.read()
    connection.close()
    return response.status, dict(response.getheaders()), content


def below(server: Server, name: str) -> str:
    return f"/{server.token}/{name}"


def test_page_files_and_viewer(server: Server) -> None:
    for name in ("", "index.html", "?a=b"):
        status, headers, content = ask(server, below(server, name))
        assert (status, content) == (200, b"<p>the page")
        assert headers["Content-Type"].startswith("text/html")
    status, _, content = ask(server, below(server, RECORDING))
    assert (status, content) == (200, (server.out / RECORDING).read_bytes())
    status, headers, content = ask(server, below(server, "viewer/re_viewer_bg.wasm"))
    assert (status, content) == (200, b"re_viewer_bg.wasm")
    assert headers["Content-Type"] == "application/wasm"
    assert "connect-src" not in headers["Content-Security-Policy"], "default-src 'self' holds"


def test_a_link_to_a_recording_opens_the_viewer(server: Server) -> None:
    navigate = {"Sec-Fetch-Mode": "navigate"}
    status, headers, _ = ask(server, below(server, RECORDING), headers=navigate)
    assert status == 303
    address = quote(f"{server.address}{RECORDING}", safe="")
    assert headers["Location"] == below(server, f"viewer/?url={address}")


def test_a_link_to_a_tab_sends_its_layout_first(server: Server) -> None:
    puck, name = recordings.Puck(), RECORDING.replace("tuning", "forecast")
    record_forecast(server.out / name, puck, recordings.examples(puck, 2), {})
    navigate = {"Sec-Fetch-Mode": "navigate"}
    status, headers, _ = ask(server, below(server, f"{name}?tab=1"), headers=navigate)
    layout = f"layouts/1/{name.replace('.rrd', '.rbl')}"
    first, second = (quote(f"{server.address}{part}", safe="") for part in (layout, name))
    assert status == 303
    assert headers["Location"] == below(server, f"viewer/?url={first}&url={second}")
    status, _, content = ask(server, below(server, layout))
    assert (status, content[:4]) == (200, b"RRF2")


@pytest.mark.parametrize("tab", ["", "x", "-1", "99999", "1&tab=2", "%2e%2e"])
def test_a_tab_that_does_not_exist(server: Server, tab: str) -> None:
    for name in (RECORDING, RECORDING.replace("tuning", "none"), "../secret.rrd"):
        layout = f"layouts/{tab}/{name.replace('.rrd', '.rbl')}"
        assert ask(server, below(server, layout))[0] == 404
    assert ask(server, below(server, f"layouts/0/{RECORDING}"))[0] == 404


def test_it_listens_on_the_loopback_interface(server: Server) -> None:
    assert server.server_address[0] == "127.0.0.1"
    assert urlsplit(server.address).hostname == "127.0.0.1"
    assert len(server.token) >= 20


@pytest.mark.parametrize("host", ["example.org", "127.0.0.1", "127.0.0.1:1", "0.0.0.0", "::1"])
def test_other_hosts_names_are_refused(server: Server, host: str) -> None:
    status, _, content = ask(server, below(server, ""), host=host)
    assert status == 421
    assert b"the page" not in content


@pytest.mark.parametrize("path", ["/", "//", "/index.html", "/{}x/", "/x{}/", "/{}", "", "/é/"])
def test_without_the_token_nothing_is_found(server: Server, path: str) -> None:
    path = quote(path.format(server.token), safe="/")
    status, _, content = ask(server, path or "*")
    assert status in (400, 404)
    assert b"the page" not in content


@pytest.mark.parametrize(
    "name",
    [
        "../secret",
        "recordings/../../secret",
        "recordings/%2e%2e/%2e%2e/secret",
        "..%2fsecret",
        "recordings/..%5c..%5csecret",
        "%2fetc%2fpasswd",
        "/etc/passwd",
        "recordings//etc/passwd",
        "recordings/secret",
        "recordings/.hidden",
        "work/secret",
        ".hidden",
        "secret",
        "recordings",
        "recordings/",
        "recordings/%00",
        "recordings/" + 300 * "x",
        "viewer/../index.html",
        "viewer/other",
    ],
)
def test_nothing_else_is_served(server: Server, name: str) -> None:
    for path in (server.out.parent / "secret", server.out / "secret", server.out / ".hidden"):
        path.write_text("secret")
    (server.out / "work").mkdir()
    (server.out / "work" / "secret").write_text("secret")
    (server.out / "recordings" / ".hidden").write_text("secret")
    os.symlink(server.out.parent / "secret", server.out / "recordings" / "secret")
    status, _, content = ask(server, below(server, name))
    assert status == 404
    assert content != b"secret"


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "PATCH", "OPTIONS"])
def test_it_writes_nothing(server: Server, method: str) -> None:
    before = files(server.out)
    assert ask(server, below(server, RECORDING), method)[0] == 405
    assert ask(server, below(server, RECORDING), "HEAD")[2] == b""
    assert files(server.out) == before


def test_every_answer_keeps_the_token_secret(server: Server) -> None:
    for path in (below(server, ""), below(server, "none"), "/"):
        _, headers, content = ask(server, path)
        assert headers["Referrer-Policy"] == "no-referrer"
        assert headers["X-Content-Type-Options"] == "nosniff"
        assert headers["Cross-Origin-Resource-Policy"] == "same-origin"
        assert "Access-Control-Allow-Origin" not in headers
        assert server.token.encode() not in content


def test_a_page_that_cannot_be_made_is_an_answer(copy: Path) -> None:
    def fail(out: Path) -> str:
        raise StudyError("no <b>page</b>")

    with running(Server(copy, page=fail)) as server:
        status, _, content = ask(server, below(server, ""))
        assert status == 500
        assert b"no &lt;b&gt;page&lt;/b&gt;" in content


@pytest.mark.parametrize("port", [70000, -1])
def test_a_port_that_does_not_exist(copy: Path, port: int) -> None:
    with pytest.raises(BadInput, match="--port"):
        Server(copy, port)


def test_a_port_in_use(server: Server) -> None:
    with pytest.raises(BadInput, match=f"cannot listen on {server.server_port}.*another"):
        Server(server.out, server.server_port)


@pytest.mark.slow
def test_the_web_viewer_of_the_package_links_to_no_other_server(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("RUST_LOG", "error")  # as a command of the study sets it
    found = web_viewer()
    assert set(found) == set(FILES)
    assert found["re_viewer_bg.wasm"].content.startswith(b"\0asm")
    page = found["index.html"].content.decode()
    assert "re_viewer.js" in page
    assert "fonts.g" not in page
