"""Pages of other origins: no frame around the live page, no other host name, no topics."""

import asyncio
import http.client

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("foxglove")

from tornado.httpclient import HTTPClientError, HTTPRequest
from tornado.websocket import websocket_connect
from view_browser import viewing

from train_ato.view.origin_gate import _accepted, host_of, may_read_topics

ORIGINS = [
    (None, True), ("http://localhost:8080", True), ("http://127.0.0.1", True), ("https://[::1]:9", True),
    ("https://app.foxglove.dev", True), ("file://", True), ("null", False), ("http://evil.example", False),
    ("http://localhost.evil.example", False), ("http://localhost@evil.example", False),
    ("https://app.foxglove.dev.evil.example", False), ("http://app.foxglove.dev", False), ("ftp://localhost", False),
    ("localhost", False), ("", False), ("http://[", False),
]  # fmt: skip
"""Origin and True if it may read the topics."""


@pytest.mark.parametrize(
    ("hosts", "accepted"),
    [(["localhost"], True), (["localhost", "evil.example"], False), (["localhost", "localhost"], False), ([], False)],
)
def test_a_request_has_one_host(hosts, accepted):
    """Breaks if a second Host header is ignored: gate and server behind it could read different ones."""
    lines = ["GET / HTTP/1.1", *(f"Host: {host}" for host in hosts), "", ""]
    assert _accepted("\r\n".join(lines).encode()) is accepted


@pytest.fixture(scope="module")
def run(demo_run):
    return demo_run("duration=5")


def answer(port: int, path: str, host: str) -> http.client.HTTPResponse:
    """Return the answer to a GET request under a host name."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=60)
    connection.request("GET", path, headers={"Host": host})
    return connection.getresponse()


async def connects(url: str, origin: str | None, host: str = "") -> bool:
    """Return True if a WebSocket is accepted."""
    headers = ({} if origin is None else {"Origin": origin}) | ({"Host": host} if host else {})
    try:
        asked = HTTPRequest(url, headers=headers)
        (await websocket_connect(asked, subprotocols=["foxglove.sdk.v1"])).close()
    except HTTPClientError as error:
        assert error.code == 403
        return False
    return True


def test_the_page_is_in_no_frame_and_under_no_other_name(run):
    """Breaks if a page of another origin can frame the live page, or read it after a change of its name server."""
    with viewing(str(run)) as view:
        port = int(view.url.rstrip("/").rpartition(":")[2])
        for path in ("/", "/static/js/bokeh.min.js", "/nothing"):
            found = answer(port, path, f"localhost:{port}")
            assert found.status == (404 if path == "/nothing" else 200)
            assert found.headers["X-Frame-Options"] == "DENY"
            assert found.headers["Content-Security-Policy"] == "frame-ancestors 'none'"
        for host in ("evil.example", f"evil.example:{port}", "localhost.evil.example", "10.0.0.1", ""):
            for path in ("/", "/ws", "/autoload.js"):
                assert answer(port, path, host).status == 403, host
        assert answer(port, "/", f"[::1]:{port}").status == 200
        assert view.end() == 0
        assert view.process.stderr.read() == ""


def test_only_pages_of_this_machine_and_foxglove_read_the_topics(run):
    """Breaks if any page that is open in a browser can read the topics of a run."""
    with viewing(str(run), "--foxglove", "0", lines=2) as view:
        url = view.lines[1].strip()
        for origin, allowed in ORIGINS:
            assert asyncio.run(connects(url, origin)) is allowed, origin
        assert asyncio.run(connects(url, None, host="evil.example")) is False
        assert view.end() == 0


def test_an_open_address_is_named(run):
    """Breaks if the page is open to other hosts and no line says so."""
    with viewing(str(run), "--address", "0.0.0.0") as view:
        assert view.end() == 0
        assert "--address 0.0.0.0: every host that reaches the page" in view.process.stderr.read()


def test_two_origins_are_refused_and_names_are_compared_without_port():
    """Breaks if a second header hides the first, or letters and ports of a name matter."""
    assert not may_read_topics("localhost", ["http://localhost", "http://evil.example"])
    names = {"LOCALHOST:80": "localhost", "[::1]:80": "::1", "[::1": "", "a@b": "b", "": ""}
    assert {text: host_of(text) for text in names} == names
