"""Talk between the runner and a node's process: one JSON object per line, over the child's standard input and output.

Parent to child: ``{"do": "begin" | "report" | "drain" | "close" | "stop" | "exit", ...}``.  Child to parent:
``{"event": "waiting" | "ready" | "progress" | "silent" | "finished" | "report" | "closed" | "failed", ...}``.
A closed pipe means that the other side is gone.
"""

from __future__ import annotations

import json
import os
import sys
import threading
from collections import deque
from collections.abc import Callable
from typing import Any


class ChildPipe:
    """The child's end.

    Parameters
    ----------
    wake
        Called from the reading thread when something came, so that the executor turns at once.
    """

    def __init__(self, wake: Callable[[], None]) -> None:
        self._out = os.fdopen(os.dup(1), "w", encoding="utf-8")
        os.dup2(2, 1)  # whatever a library prints must not come between the events
        self._wake = wake
        self.inbox: deque[dict[str, Any]] = deque()
        threading.Thread(target=self._read, name="orders", daemon=True).start()

    def _read(self) -> None:
        for line in sys.stdin:
            self.inbox.append(json.loads(line))
            self._wake()
        self.inbox.append({"do": "exit", "orphan": True})
        self._wake()

    def send(self, event: str, **values: Any) -> None:
        """Tell the parent something; a parent that is gone is noticed by the reading side."""
        try:
            self._out.write(json.dumps({"event": event, **values}) + "\n")
            self._out.flush()
        except OSError:
            pass
