"""Foxglove WebSocket: topics with definitions, bytes of the log, time; pages and tools of other origins."""

import asyncio
import http.client
import json
import socket
import struct
import time
from contextlib import closing
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("foxglove")

from tornado.websocket import websocket_connect
from view_browser import connects, viewing
from waiting import LIMIT_S

from train_ato.log.reading import iter_raw
from train_ato.messages.topics import EPOCH_NS
from train_ato.view.foxglove import FoxgloveServer, _Played
from train_ato.view.origin_gate import _accepted, host_of, may_read_topics
from train_ato.view.recorded import RecordedFeed

PROTOCOLS = ["foxglove.sdk.v1", "foxglove.websocket.v1"]
MESSAGE, TIME = 1, 2
"""First byte of the server's binary messages."""


@pytest.fixture(scope="module")
def run(demo_run):
    return demo_run("duration=30")


class Client:
    """Foxglove client that stores the received messages."""

    def __init__(self, connection):
        self._connection = connection
        self.channels = {}
        self.messages = {}
        self.times = []
        self.told = []
        self._numbers = {}

    @classmethod
    async def connect(cls, url):
        return cls(await websocket_connect(url, subprotocols=PROTOCOLS))

    async def until(self, condition):
        """Read until a condition holds."""
        last = time.monotonic() + LIMIT_S
        while not condition():
            assert time.monotonic() < last, f"never came; told {[entry.get('op') for entry in self.told]}"
            try:
                data = await asyncio.wait_for(self._connection.read_message(), 0.5)
            except asyncio.TimeoutError:
                continue
            assert data is not None, "the server has left"
            self._take(data)

    def _take(self, data):
        if isinstance(data, str):
            entry = json.loads(data)
            self.told.append(entry)
            if entry["op"] == "advertise":
                self.channels |= {channel["topic"]: channel for channel in entry["channels"]}
        elif data[0] == MESSAGE:
            number, moment = struct.unpack_from("<IQ", data, 1)
            self.messages.setdefault(self._numbers[number], []).append((moment, bytes(data[13:])))
        elif data[0] == TIME:
            self.times.append(struct.unpack_from("<Q", data, 1)[0])

    async def subscribe(self, *topics):
        wanted = []
        for topic in topics:
            self._numbers[len(self._numbers) + 1] = topic
            wanted.append({"id": len(self._numbers), "channelId": self.channels[topic]["id"]})
        await self._connection.write_message(json.dumps({"op": "subscribe", "subscriptions": wanted}))


def test_a_recorded_run_goes_to_foxglove_as_it_was_recorded(run):
    """Breaks if a definition, a byte or a time differs from the log, or the latched profile does not arrive."""
    feed = RecordedFeed(run)
    feed.seek(0.0)

    async def look(server):
        client = await Client.connect(server.url)
        await client.until(lambda: "/train/vehicles" in client.channels)
        cars = client.channels["/train/vehicles"]
        kind = "sensor_msgs/msg/JointState"
        assert (cars["encoding"], cars["schemaName"], cars["schemaEncoding"]) == ("cdr", kind, "ros2msg")
        assert "float64[] effort" in cars["schema"] and "MSG: std_msgs/Header" in cars["schema"]
        await client.subscribe("/train/vehicles", "/ato/profile")
        await client.until(lambda: client.messages.get("/ato/profile") and client.messages.get("/train/vehicles"))
        feed.speed = 20.0
        feed.set_playing(playing=True)
        await client.until(lambda: feed.time >= 30.0 and len(client.messages["/train/vehicles"]) > 250)
        await client.until(lambda: client.times and client.times[-1] == EPOCH_NS + 30 * 10**9)
        return client

    with closing(FoxgloveServer(feed, 0)) as server:
        client = asyncio.run(look(server))
    recorded = {EPOCH_NS + stamp: bytes(data) for _, stamp, data in iter_raw(run, ("train/vehicles",))}
    moments = [moment for moment, _ in client.messages["/train/vehicles"]]
    assert moments == sorted(moments)
    assert all(recorded[moment] == data for moment, data in client.messages["/train/vehicles"])
    gaps = {round((b - a) / 1e8) for a, b in pairwise(moments)}
    assert gaps <= {0, 1}, "messages are missing"
    assert client.times == sorted(client.times)


def test_a_busy_machine_skips_no_message_of_a_fast_run(run):
    """Breaks if a period of a third of a second skips messages of a run that is played 20 times as fast."""
    feed, sent = RecordedFeed(run), []
    played = _Played(feed, ["train/vehicles"])
    feed.seek(0.0)
    feed.speed = 20.0
    feed.set_playing(playing=True)
    for _ in range(3):
        played.poll(lambda _topic, moment_ns, _data: sent.append(moment_ns))
        time.sleep(0.3)
    played.close()
    assert len(sent) > 50 and {round((b - a) / 1e8) for a, b in pairwise(sent)} == {1}


def test_a_log_of_the_former_types_keeps_them(tmp_path):
    """Breaks if the bytes of an older log are sent as a type that they are not."""
    (tmp_path / "run.mcap").write_bytes((Path(__file__).parent / "data" / "former_types.mcap").read_bytes())

    async def look(server):
        client = await Client.connect(server.url)
        await client.until(lambda: {"/ato/state", "/atp/speeds"} <= set(client.channels))
        return client.channels["/ato/state"]["schemaName"]

    with closing(FoxgloveServer(RecordedFeed(tmp_path), 0)) as server:
        assert asyncio.run(look(server)) == "sensor_msgs/msg/JointState"


def test_foxgloves_player_moves_the_time_of_the_page(run):
    """Breaks if play, pause or the time slider of Foxglove have no effect."""
    feed = RecordedFeed(run)

    async def look(server):
        client = await Client.connect(server.url)
        await client.until(lambda: any(entry["op"] == "serverInfo" for entry in client.told))
        info = next(entry for entry in client.told if entry["op"] == "serverInfo")
        assert {"time", "playbackControl"} <= set(info["capabilities"])

    with closing(FoxgloveServer(feed, 0)) as server:
        asyncio.run(look(server))

        from foxglove.websocket import PlaybackCommand

        asked = SimpleNamespace(playback_command=PlaybackCommand.Play, playback_speed=5.0, request_id="1")
        asked.seek_time = EPOCH_NS + 12 * 10**9
        state = server.listener.on_playback_control_request(asked)
        assert feed.playing and feed.speed == 5.0 and feed.time >= 12.0 and state.did_seek
        asked.playback_command, asked.seek_time = PlaybackCommand.Pause, None
        server.listener.on_playback_control_request(asked)
        assert not feed.playing


def test_a_port_in_use_is_refused_in_one_line(run):
    """Breaks if the user sees the exception of the library, or a thread remains."""
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        refused = pytest.raises(ValueError, match=f"--foxglove {port}: .*give another port")
        with refused, closing(FoxgloveServer(RecordedFeed(run), port)):
            pass


@pytest.mark.graph
def test_a_live_run_goes_to_foxglove(tmp_path):
    """Breaks if a running graph does not reach Foxglove, with its time and its latched profile."""
    from view_browser import viewing

    options = ("--scenario", "demo", "--rate", "10", "--out", str(tmp_path / "run"), "--foxglove", "0")
    with viewing(*options, lines=2) as view:
        assert view.lines[1].startswith("ws://127.0.0.1:")

        async def look():
            client = await Client.connect(view.lines[1])
            await client.until(lambda: "/train/vehicles" in client.channels)
            await client.subscribe("/train/vehicles", "/ato/profile", "/diagnostics")
            await client.until(lambda: len(client.messages.get("/train/vehicles", ())) > 30)
            await client.until(lambda: client.messages.get("/ato/profile") and client.messages.get("/diagnostics"))
            await client.until(lambda: len(client.times) > 10)
            return client

        client = asyncio.run(look())
        assert view.end() == 0
    stamps = [moment for moment, _ in client.messages["/train/vehicles"]]
    assert stamps == sorted(stamps)
    assert client.times == sorted(client.times)


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
def short_run(demo_run):
    return demo_run("duration=5")


def answer(port: int, path: str, host: str) -> http.client.HTTPResponse:
    """Return the answer to a GET request under a host name."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=60)
    connection.request("GET", path, headers={"Host": host})
    return connection.getresponse()


def test_pages_of_others_reach_nothing(short_run):
    """Breaks if a page of another origin can frame, read or control the live page, or read the topics of a run.

    It must not do so after a change of its name server either; and other machines cannot connect.
    """
    with viewing(str(short_run), "--foxglove", "0", lines=2) as view:
        page, url = view.url.rstrip("/"), view.lines[1].strip()
        port = int(page.rpartition(":")[2])
        for path in ("/", "/static/js/bokeh.min.js", "/nothing"):
            found = answer(port, path, f"localhost:{port}")
            assert found.status == (404 if path == "/nothing" else 200)
            assert found.headers["X-Frame-Options"] == "DENY"
            assert found.headers["Content-Security-Policy"] == "frame-ancestors 'none'"
        for host in ("evil.example", f"evil.example:{port}", "localhost.evil.example", "10.0.0.1", ""):
            for path in ("/", "/ws", "/autoload.js"):
                assert answer(port, path, host).status == 403, host
        assert answer(port, "/", f"[::1]:{port}").status == 200
        for origin, allowed in (("http://evil.example", False), (page, True)):
            assert asyncio.run(connects(f"ws://127.0.0.1:{port}/ws", origin, "bokeh", "no token")) is allowed, origin
        for origin, allowed in ORIGINS:
            assert asyncio.run(connects(url, origin, PROTOCOLS[0])) is allowed, origin
        assert asyncio.run(connects(url, None, PROTOCOLS[0], host="evil.example")) is False
        for found in socket.getaddrinfo(socket.gethostname(), None, socket.AF_INET):
            if not found[4][0].startswith("127."):
                with socket.socket() as outside:
                    outside.settimeout(5)
                    assert outside.connect_ex((found[4][0], port)) != 0
        assert view.end() == 0
        assert view.process.stderr.read() == ""


def test_an_open_address_is_named(short_run):
    """Breaks if the page is open to other hosts and no line says so."""
    with viewing(str(short_run), "--address", "0.0.0.0") as view:
        assert view.end() == 0
        assert "--address 0.0.0.0: every host that reaches the page" in view.process.stderr.read()


def test_two_origins_are_refused_and_names_are_compared_without_port():
    """Breaks if a second header hides the first, or letters and ports of a name matter."""
    assert not may_read_topics("localhost", ["http://localhost", "http://evil.example"])
    names = {"LOCALHOST:80": "localhost", "[::1]:80": "::1", "[::1": "", "a@b": "b", "": ""}
    assert {text: host_of(text) for text in names} == names
