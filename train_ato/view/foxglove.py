"""Foxglove WebSocket: the ROS 2 messages of a run with their definitions, and the train on its line.

For a live run the newest messages of every topic are sent 20 times a second; for a recorded run all messages are sent
in simulated time, and Foxglove's player also controls the time of the page.
"""

import threading
from collections import deque
from collections.abc import Callable, Iterator
from typing import Any, cast

import foxglove
from foxglove import Capability, Channel, Context, Schema
from foxglove.websocket import PlaybackCommand, PlaybackControlRequest, PlaybackState, PlaybackStatus, ServerListener

from train_ato.log.bag_layout import log_name, table_name
from train_ato.log.definitions import definition
from train_ato.log.mcap_records import RawMessage
from train_ato.messages.topics import BY_NAME, EPOCH_NS, topic_of, topics_of
from train_ato.playback.log import ReplayLog
from train_ato.view.feed import FRAMES_PER_SECOND, Feed
from train_ato.view.live import LiveFeed
from train_ato.view.origin_gate import LOOPBACK, OriginGate, hidden_address
from train_ato.view.reader import Copied
from train_ato.view.recorded import RecordedFeed
from train_ato.view.train_scene import VEHICLES, TrainScene

MAX_AT_ONCE = 20_000
"""Messages of a recorded run sent in one period; the rest of a longer interval is skipped."""
MAX_STALL_NS = 2_000_000_000
"""Longest period of a loaded machine after which no message of a recorded run is skipped [ns]."""

Send = Callable[[str, int, bytes], None]
"""Callback for a message: topic of the table, ns since 1970, bytes."""


class _Newest:
    """Messages of a live run, from the thread of the feed; ``types`` by topic are those of the table."""

    def __init__(self, feed: LiveFeed) -> None:
        self.types: dict[str, str] = {}
        self._feed = feed
        self._copies: deque[Copied] | None = None

    def poll(self, send: Send | None) -> int | None:
        """Pass new messages to ``send`` if given; return the present time [ns since 1970], None if unknown."""
        if send is None:
            self.close()
        elif self._copies is None:
            self._copies = self._feed.subscribe()
        while self._copies and send is not None:
            send(*self._copies.popleft())
        frame = self._feed.frame
        return None if frame is None else EPOCH_NS + round(frame.moment.time * 1e9)

    def close(self) -> None:
        if self._copies is not None:
            self._feed.unsubscribe(self._copies)
            self._copies = None


class _Played:
    """Messages of a recorded run up to the time of the feed; ``types`` by topic are those of the log."""

    def __init__(self, feed: RecordedFeed, topics: list[str]) -> None:
        self._feed = feed
        self._log = ReplayLog(feed.recording.path)
        self._names = {name: table_name(name) for name in self._log.topics if table_name(name) in topics}
        kinds = {str(topic): self._log.topics[name].type for name, topic in self._names.items()}
        self.types = {topic: kind for topic, kind in kinds.items() if topic_of(topic, kind)}  # also former ones
        self._depths = {name: 1 for name in self._names if BY_NAME[str(self._names[name])].latched}
        self._messages: Iterator[RawMessage] = iter(())
        self._ahead: RawMessage | None = None
        self._time = -1

    def poll(self, send: Send | None) -> int:
        """Pass the messages up to the time of the feed to ``send`` if given; return this time [ns since 1970]."""
        self._feed.advance()
        now = EPOCH_NS + round(self._feed.time * 1e9)
        if send is None:
            self._time = -1
            return now
        step = now - self._time
        if self._time < 0 or step < 0 or step > MAX_STALL_NS * max(1.0, self._feed.speed):
            self._enter(now, send)
        self._time = now
        for _ in range(MAX_AT_ONCE):
            message = self._ahead or next(self._messages, None)
            self._ahead = message
            if message is None or message.publish_ns > now:
                return now
            self._ahead = None
            send(str(self._names[message.channel.topic]), message.publish_ns, bytes(message.data))
        self._enter(now, send)
        return now

    def _enter(self, now: int, send: Send) -> None:
        """Continue from another time; send the latched messages in force there."""
        for message in self._log.standing(self._depths, now):
            send(str(self._names[message.channel.topic]), message.publish_ns, bytes(message.data))
        tick = round(self._feed.tick * 1e9)
        self._messages = self._log.messages([*self._names], now - tick + 1)
        self._ahead = None

    def close(self) -> None:
        self._log.close()


class FoxgloveServer:
    """WebSocket server with one channel for each topic.

    Parameters
    ----------
    feed
        Feed of the page.
    port
        Port on this machine; 0 selects a free one.

    Attributes
    ----------
    url : str
        Address for Foxglove.
    listener
        Handler of the requests of Foxglove.
    """

    def __init__(self, feed: Feed, port: int) -> None:
        # Channels close with the last reference to their context.
        self._context = context = Context()
        topics = [topic for topic in topics_of(feed.facts.layout) if topic.recorded]
        names = [topic.name for topic in topics]
        self._source = _Newest(cast("LiveFeed", feed)) if feed.live else _Played(cast("RecordedFeed", feed), names)
        types = {topic.name: self._source.types.get(topic.name, topic.type) for topic in topics}
        self._channels = {topic.name: _channel(log_name(topic), types[topic.name], context) for topic in topics}
        self._latched = {topic.name for topic in topics if topic.latched}
        self._drawn = None if feed.facts.setup is None else TrainScene(feed.facts.setup)
        self._scene: dict[str, Channel] = {}
        self._kept: dict[str, tuple[bytes, int]] = {}
        if self._drawn is not None:
            self._scene = {topic.name: _channel(topic.name, topic.type, context) for topic in self._drawn.topics}
            self._kept = {topic.name: (data, EPOCH_NS) for topic, data in self._drawn.begin()}
        self._stopping = threading.Event()
        capabilities = [Capability.Time]
        span = None
        if not feed.live:
            begin, end = cast("RecordedFeed", feed).span
            span = (EPOCH_NS + round(begin * 1e9), EPOCH_NS + round(end * 1e9))
            capabilities.append(Capability.PlaybackControl)
        self.listener = _Listener(self, feed)
        try:
            self._server, self._gate = _gated(
                port,
                name=f"train_ato: {feed.facts.title}",
                capabilities=capabilities,
                server_listener=self.listener,
                supported_encodings=["cdr"],
                context=context,
                playback_time_range=span,
            )
        except Exception as error:  # the exception type is that of the Rust library
            self._source.close()
            raise ValueError(
                f"--foxglove {port}: {' '.join(str(error).split())}; give another port, or 0 for a free one"
            ) from None
        self.url = f"ws://{LOOPBACK}:{self._gate.port}"
        self._thread = threading.Thread(target=self._run, name="foxglove", daemon=True)
        self._thread.start()

    def _run(self) -> None:
        shown = -1
        while not self._stopping.wait(1.0 / FRAMES_PER_SECOND):
            channels = (*self._channels.values(), *self._scene.values())
            wanted = any(channel.has_sinks() for channel in channels)
            now = self._source.poll(self._send if wanted else None)
            if now is not None and now != shown:
                shown = now
                self._server.broadcast_time(now)

    def _send(self, topic: str, moment_ns: int, data: bytes) -> None:
        if topic in self._latched:
            self._kept[topic] = (data, moment_ns)
        self._channels[topic].log(data, log_time=moment_ns)
        if topic == VEHICLES and self._drawn is not None and any(c.has_sinks() for c in self._scene.values()):
            for part, content in self._drawn.take(data):
                self._scene[part.name].log(content, log_time=moment_ns)

    def greet(self, topic: str) -> None:
        """Send the latched message of a topic again for a late subscriber."""
        name = topic if topic in self._scene else table_name(topic)
        if name in self._kept:
            data, moment_ns = self._kept[name]
            (self._scene.get(name) or self._channels[name]).log(data, log_time=moment_ns)

    def close(self) -> None:
        """Stop the thread and the server."""
        self._stopping.set()
        self._thread.join(timeout=2.0)
        self._source.close()
        self._gate.close()
        self._server.stop()
        for channel in (*self._channels.values(), *self._scene.values()):
            channel.close()


def _gated(port: int, **options: Any) -> tuple[foxglove.websocket.WebSocketServer, OriginGate]:
    """Start a server with the options behind a gate at a port of this machine."""
    hidden = hidden_address()
    server = foxglove.start_server(host=hidden, port=0, **options)
    try:
        return server, OriginGate(port, (hidden, server.port))
    except OSError:
        server.stop()
        raise


class _Listener(ServerListener):
    """Handler of subscriptions and of the player's requests."""

    def __init__(self, server: FoxgloveServer, feed: Feed) -> None:
        self._server = server
        self._feed = feed

    def on_subscribe(self, client: Any, channel: Any) -> None:
        self._server.greet(channel.topic)

    def on_playback_control_request(self, playback_control_request: PlaybackControlRequest) -> PlaybackState | None:
        """Play, pause or seek as requested by the player."""
        request, feed = playback_control_request, self._feed
        if not isinstance(feed, RecordedFeed):
            return None
        if request.seek_time is not None:
            feed.seek((request.seek_time - EPOCH_NS) * 1e-9)
        feed.speed = request.playback_speed
        feed.set_playing(playing=request.playback_command == PlaybackCommand.Play)
        return PlaybackState(
            status=PlaybackStatus.Playing if feed.playing else PlaybackStatus.Paused,
            current_time=EPOCH_NS + round(feed.time * 1e9),
            playback_speed=feed.speed,
            did_seek=request.seek_time is not None,
            request_id=request.request_id,
        )


def _channel(name: str, kind: str, context: Context) -> Channel:
    schema = Schema(name=kind, encoding="ros2msg", data=definition(kind).text.encode())
    return Channel(name, schema=schema, message_encoding="cdr", context=context)
