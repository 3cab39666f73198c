"""A node's process as the runner sees it."""

from __future__ import annotations

import contextlib
import json
import os
import queue
import signal
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

from train_ato.topics import Role

Event = tuple[Role, dict[str, Any]]
_PACKAGE_ROOT = str(Path(__file__).resolve().parents[2])


class Child:
    """One process and the thread that reads its events.

    Parameters
    ----------
    role
        Which node it runs.
    arguments
        Options of the node.
    variables
        Environment on top of this process's own.
    log_folder
        Where its standard error goes.
    events
        Takes its events; the last one is ``{"event": "ended"}``.
    """

    def __init__(
        self, role: Role, arguments: list[str], variables: dict[str, str], log_folder: Path, events: queue.Queue[Event]
    ) -> None:
        self.role = role
        self.ended = False
        self._events = events
        self._errors = log_folder / f"{role.value}.stderr.txt"
        environment = {**os.environ, **variables}
        paths = [_PACKAGE_ROOT, *filter(None, environment.get("PYTHONPATH", "").split(os.pathsep))]
        environment["PYTHONPATH"] = os.pathsep.join(paths)
        command = [sys.executable, "-m", f"train_ato.nodes.{role.value}", *arguments, "--pipes"]
        with self._errors.open("wb") as errors:
            # A session of its own, so that the terminal's Ctrl-C reaches the runner alone.
            self.process = subprocess.Popen(
                command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=errors,
                env=environment,
                start_new_session=True,
                text=True,
                bufsize=1,
            )
        threading.Thread(target=self._read, name=f"events of {role.value}", daemon=True).start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            try:
                event = json.loads(line)
            except ValueError:
                continue
            self._events.put((self.role, event))
        self._events.put((self.role, {"event": "ended"}))

    def tell(self, action: str, **values: Any) -> None:
        """Send an order; a process that is gone is noticed by its closed pipe."""
        assert self.process.stdin is not None
        with contextlib.suppress(OSError, ValueError):
            self.process.stdin.write(json.dumps({"do": action, **values}) + "\n")
            self.process.stdin.flush()

    def obituary(self) -> str:
        """Say how the process ended."""
        try:
            status = self.process.wait(timeout=1.0)
        except subprocess.TimeoutExpired:
            return "its pipe is closed"
        if status < 0:
            return f"its process was ended by {signal.Signals(-status).name}"
        lines = [line for line in self._errors.read_text(errors="replace").splitlines() if line.strip()]
        return f"its process ended with status {status}" + (f": {lines[-1].strip()}" if lines else "")

    def end(self, patience: float) -> None:
        """Make sure that the process is gone: ask, SIGTERM, SIGKILL; without patience at once."""
        self.tell("exit")
        gentle = ((patience, signal.SIGTERM), (1.0, signal.SIGKILL)) if patience > 0 else ((0.0, signal.SIGKILL),)
        for limit, number in (*gentle, (5.0, None)):
            try:
                self.process.wait(timeout=limit)
                break
            except subprocess.TimeoutExpired:
                if number is not None:
                    self.process.send_signal(number)
        for stream in (self.process.stdin, self.process.stdout):
            with contextlib.suppress(OSError):
                if stream is not None:
                    stream.close()
