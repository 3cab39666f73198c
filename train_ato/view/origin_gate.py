"""Gate in front of the Foxglove server, which accepts every origin.

``foxglove-sdk`` has no check of the ``Origin`` header.  The gate reads the head of a connection, refuses pages of other
origins and forwards all others.  The server itself listens on a random address of 127.0.0.0/8 and a random port, more
than 10^11 places, so that a web page cannot find it beside the gate.

Every web page can open a WebSocket to this machine; only its origin distinguishes it from a program of the user.
"""

import asyncio
import random
import threading
from contextlib import suppress
from urllib.parse import urlsplit

LOOPBACK = "127.0.0.1"
LOCAL_IPV6 = "::1"
LOCAL_NAMES = frozenset(("localhost", LOOPBACK, LOCAL_IPV6))
"""Names of this machine that no other host can have."""
FOXGLOVE_ORIGINS = frozenset(("https://app.foxglove.dev", "https://studio.foxglove.dev", "file://"))
"""Origins of Foxglove: its web app, and its desktop app, whose pages are files."""


def host_of(header: str) -> str:
    """Return the host name of a ``Host`` header without its port, in lower case; empty if it is not valid."""
    try:
        return urlsplit(f"//{header}").hostname or ""
    except ValueError:
        return ""


def may_read_topics(host: str, origins: list[str]) -> bool:
    """Return True if a WebSocket client may read the topics of the run.

    Parameters
    ----------
    host
        ``Host`` header; a name of this machine is accepted.
    origins
        All ``Origin`` headers.  None is a program, which the user started; pages must come from this machine or from
        Foxglove.  The origin ``null``, which every page can have, is refused.
    """
    if host_of(host) not in LOCAL_NAMES or len(origins) > 1:
        return False
    if not origins or origins[0] in FOXGLOVE_ORIGINS:
        return True
    scheme, separator, rest = origins[0].partition("://")
    return scheme in ("http", "https") and bool(separator) and host_of(rest) in LOCAL_NAMES


MAX_HEAD = 1 << 14
"""Maximum size of the head of a request [bytes]."""
HEAD_S = 10.0
"""Maximum wall time for the head of a request [s]."""
BLOCK = 1 << 16
_END = b"\r\n\r\n"
_REFUSAL = b"HTTP/1.1 403 Forbidden\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"


def hidden_address() -> str:
    """Return a random loopback address except those of 127.0.0.0/16."""
    chance = random.SystemRandom()
    return f"127.{chance.randint(1, 254)}.{chance.randint(0, 254)}.{chance.randint(1, 254)}"


class OriginGate:
    """Forwarding of the accepted WebSocket connections of one port, in a thread.

    Parameters
    ----------
    port
        Port on this machine; 0 selects a free one.
    target
        Address and port of the server behind the gate.

    Attributes
    ----------
    port : int
        Port of the gate.

    Raises
    ------
    OSError
        If the port is not available.
    """

    def __init__(self, port: int, target: tuple[str, int]) -> None:
        self._target = target
        self._loop = asyncio.new_event_loop()
        try:
            self._server = self._loop.run_until_complete(
                asyncio.start_server(self._accept, LOOPBACK, port, limit=MAX_HEAD)
            )
        except OSError:
            self._loop.close()
            raise
        self.port = int(self._server.sockets[0].getsockname()[1])
        self._thread = threading.Thread(target=self._loop.run_forever, name="origin gate", daemon=True)
        self._thread.start()

    async def _accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Read the head of a connection; refuse it or forward it."""
        with suppress(OSError, asyncio.IncompleteReadError, asyncio.LimitOverrunError, asyncio.TimeoutError):
            head = await asyncio.wait_for(reader.readuntil(_END), HEAD_S)
            if not _accepted(head):
                writer.write(_REFUSAL)
                await writer.drain()
            else:
                onward = await asyncio.open_connection(*self._target)
                onward[1].write(head)
                await asyncio.gather(_copy(reader, onward[1]), _copy(onward[0], writer))
        writer.close()

    def close(self) -> None:
        """Close all connections and the port."""
        self._loop.call_soon_threadsafe(self._server.close)
        asyncio.run_coroutine_threadsafe(end_connections(), self._loop).result()
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()


async def end_connections() -> None:
    """End all other tasks of the loop, which are its open connections."""
    others = [task for task in asyncio.all_tasks() if task is not asyncio.current_task()]
    for task in others:
        task.cancel()
    await asyncio.gather(*others, return_exceptions=True)


def _accepted(head: bytes) -> bool:
    """Return True if the head of a request has an accepted host and origin."""
    fields = [line.partition(":") for line in head.decode("latin-1").split("\r\n")[1:]]
    values = {name: [text.strip() for key, _, text in fields if key.lower() == name] for name in ("host", "origin")}
    return len(values["host"]) == 1 and may_read_topics(values["host"][0], values["origin"])


async def _copy(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    """Copy bytes up to the end of the connection; close the other side."""
    try:
        while data := await reader.read(BLOCK):
            writer.write(data)
            await writer.drain()
    except OSError:
        pass
    finally:
        writer.close()
