"""Web server of the page: on this machine only by default, and only for its own pages."""

import asyncio
import errno
import logging
import os
import socket
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from bokeh.application import Application
from bokeh.application.handlers.function import FunctionHandler
from bokeh.embed.server import server_html_page_for_session
from bokeh.server.server import BaseServer
from bokeh.server.tornado import BokehTornado
from bokeh.server.util import bind_sockets
from bokeh.server.views.doc_handler import DocHandler
from bokeh.util.token import generate_jwt_token, generate_session_id
from tornado.httpserver import HTTPServer
from tornado.httputil import HTTPHeaders, HTTPServerRequest
from tornado.ioloop import IOLoop, PeriodicCallback
from tornado.web import OutputTransform, RequestHandler

from train_ato.report.words import REPORT
from train_ato.view.feed import REPORT_PAGE, Feed
from train_ato.view.origin_gate import LOCAL_IPV6, LOOPBACK, end_connections, host_of
from train_ato.view.page import MARK_PATH, ViewPage

ANYWHERE = ("0.0.0.0", "::", "")
UNUSED_MS = 5_000
"""Time after which the state of a closed browser window is dropped."""
MAX_MESSAGE = 1 << 20


class PageServer:
    """Web server of one feed.

    Parameters
    ----------
    feed
        Data of the pages, common to all browsers.
    address, port
        Address and port of the server; port 0 selects a free one.

    Attributes
    ----------
    url : str
        Address of the page.
    pages : list of ViewPage
        Open pages.
    """

    def __init__(self, feed: Feed, address: str = LOOPBACK, port: int = 0) -> None:
        if not os.environ.get("TRAIN_ATO_DEBUG"):
            for name in ("bokeh", "tornado"):
                logging.getLogger(name).setLevel(logging.CRITICAL)
        self.pages: list[ViewPage] = []
        self._feed = feed
        self._asyncio = asyncio.new_event_loop()
        asyncio.set_event_loop(self._asyncio)
        self._loop = IOLoop.current()
        try:
            sockets, self.port = bind_sockets(address, port)
        except OSError as error:
            self._asyncio.close()
            if error.errno == errno.EADDRINUSE:
                raise ValueError(f"--port {port}: already in use; give another port, or 0 for a free one") from None
            raise ValueError(f"--address {address}, --port {port}: {error.strerror or error}") from None
        host = LOOPBACK if address in ANYWHERE else address
        self.url = f"http://{f'[{host}]' if ':' in host else host}:{self.port}/"
        application = _Guarded(
            {"/": Application(FunctionHandler(self._fill))},
            extra_patterns=[(REPORT_PAGE, ReportHandler, {"feed": feed}), (MARK_PATH, _Text, {"text": feed.mark})],
            extra_websocket_origins=[f"{name}:{self.port}" for name in _names(address)],
            absolute_url=self.url,
            websocket_max_message_size_bytes=MAX_MESSAGE,
            unused_session_lifetime_milliseconds=UNUSED_MS,
            check_unused_sessions_milliseconds=UNUSED_MS,
        )
        application.hosts = {*_names(address), LOCAL_IPV6}
        for rule in application.wildcard_router.rules:
            if rule.target is DocHandler:
                rule.target = _Page
        application.add_transform(_NoFrames)
        http = HTTPServer(application)
        http.add_sockets(sockets)
        self._server = BaseServer(self._loop, application, http)

    def _fill(self, document: Any) -> None:
        page = ViewPage(document, self._feed)
        self.pages.append(page)
        document.on_session_destroyed(lambda _: self.pages.remove(page))

    def run(self, stopped: Callable[[], bool]) -> None:
        """Serve until ``stopped``, called ten times a second, returns True."""
        self._server.start()

        def look() -> None:
            if stopped():
                self._loop.stop()

        looking = PeriodicCallback(look, 100)
        looking.start()
        try:
            self._loop.start()
        finally:
            looking.stop()  # it would end the loop again while the connections are closed
            self._server.unlisten()
            self._server.stop()
            self._loop.run_sync(end_connections)
            self._loop.close(all_fds=True)
            asyncio.set_event_loop(None)


class _Page(DocHandler):  # type: ignore[misc]  # bokeh has no types
    """Handler that returns the page without its figures; the WebSocket of a browser makes the session with them."""

    async def get(self, *_: Any, **__: Any) -> None:
        """Answer with the page of the first session under the token of a new one."""
        app = self.application
        if app.page is None:
            session = await self.get_session()
            document = session.document
            html = server_html_page_for_session(
                session, app.resources(), document.title, document.template, document.template_variables
            )
            app.page = html.split(session.token)
            self.finish(html)
            return
        name = generate_session_id(secret_key=app.secret_key, signed=app.sign_sessions)
        given: dict[str, Any] = {"headers": {}, "cookies": {}, "arguments": {}}
        token = generate_jwt_token(
            name, app.secret_key, app.sign_sessions, extra_payload=given, expiration=app.session_token_expiration
        )
        self.finish(token.join(app.page))


class _NoFrames(OutputTransform):
    """Headers of every answer: no page of another origin can show this one in a frame and direct clicks to it."""

    def transform_first_chunk(
        self, status_code: int, headers: HTTPHeaders, chunk: bytes, finishing: bool
    ) -> tuple[int, HTTPHeaders, bytes]:
        """Add the headers."""
        headers["Content-Security-Policy"] = "frame-ancestors 'none'"
        headers["X-Frame-Options"] = "DENY"
        return status_code, headers, chunk


class _Guarded(BokehTornado):  # type: ignore[misc]  # bokeh has no types
    """Application that answers only under the names of its server.

    A page of another origin can direct its own name to this machine (DNS rebinding) and then read answers as its own.
    """

    hosts: frozenset[str] | set[str] = frozenset()
    page: list[str] | None = None
    """Page of the feed, cut at the token of its session; None before the first request."""

    def find_handler(self, request: HTTPServerRequest, **more: Any) -> Any:
        """Return the handler of a request, or a refusal for another host name."""
        reached = request.connection.stream.socket.getsockname()[0]  # type: ignore[union-attr]
        if host_of(request.headers.get("Host", "")) in {*self.hosts, reached}:
            return super().find_handler(request, **more)
        message = "403: the host name is not that of this server; open the printed address\n"
        return self.get_handler_delegate(request, _Text, {"text": message, "status": 403})


class _Text(RequestHandler):
    """Handler that answers every request with one text."""

    def initialize(self, text: str, status: int = 200) -> None:
        """Store text and status."""
        self._text, self._status = text, status

    def prepare(self) -> None:
        """Answer."""
        self.set_status(self._status)
        self.set_header("Content-Type", "text/plain")
        self.finish(self._text)


def _names(address: str) -> list[str]:
    """Return the host names accepted as the origin of a WebSocket; all others are rejected."""
    names = {"localhost", LOOPBACK}
    if address in ANYWHERE:
        names |= {socket.gethostname(), socket.getfqdn()}
        names |= {str(found[4][0]) for found in socket.getaddrinfo(socket.gethostname(), None, socket.AF_INET)}
    else:
        names.add(address)
    return sorted(names)


class ReportHandler(RequestHandler):
    """Handler that returns the report of the run of a feed."""

    def initialize(self, feed: Feed) -> None:
        """Store the feed."""
        self._feed = feed

    async def get(self) -> None:
        """Answer with the report, or with status 404 and one line for a run without one."""
        folder = self._feed.folder
        if folder is None or self._feed.ending is None:
            await self._refuse("no report: the run has not ended, or its folder is not on this machine")
            return
        page, said = folder / REPORT, ""
        if not page.is_file():
            said = await _written(folder)
        if page.is_file():
            await self.finish(page.read_bytes())
        else:
            await self._refuse(said or f"no report of {folder}")

    async def _refuse(self, text: str) -> None:
        self.set_status(404)
        self.set_header("Content-Type", "text/plain; charset=utf-8")
        await self.finish(f"{text}\n")


async def _written(folder: Path) -> str:
    """Write the report in another process, so that the pages stay in time; return its error line."""
    command = (sys.executable, "-m", "train_ato", "report", str(folder))
    process = await asyncio.create_subprocess_exec(
        *command, stdout=asyncio.subprocess.DEVNULL, stderr=asyncio.subprocess.PIPE
    )
    _, said = await process.communicate()
    return said.decode(errors="replace").strip()
