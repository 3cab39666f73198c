"""Report of the shown run on the server of the page; it is written at the first request."""

from __future__ import annotations

import asyncio
import sys
from pathlib import Path

from tornado.web import RequestHandler

from train_ato.apps.report.words import REPORT
from train_ato.apps.view.feed import Feed


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
