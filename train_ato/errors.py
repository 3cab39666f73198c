"""The first failure of a run: which node, and why, in one line; the traceback goes to a file."""

from __future__ import annotations

import traceback
from contextlib import suppress
from pathlib import Path


class RunFailed(Exception):
    """A run that ended by a failure; the message says which node and why."""


class Watch:
    """First failure in this process; it ends the run.

    Parameters
    ----------
    log_folder
        Where the traceback of a failure is kept for developers; None keeps none.
    """

    def __init__(self, log_folder: Path | None = None) -> None:
        self._log_folder = log_folder
        self.failure: str | None = None

    def fail(self, node: str, reason: str | BaseException) -> None:
        """Remember that a node failed; later failures follow from the first and are dropped."""
        if self.failure is not None:
            return
        text = " ".join(str(reason).split()) or type(reason).__name__
        if isinstance(reason, BaseException) and not isinstance(reason, (ValueError, OSError, RunFailed)):
            text = f"{type(reason).__name__}: {text}"
        self.failure = f"node {node} failed: {text}"
        if isinstance(reason, BaseException) and self._log_folder is not None:
            trace = "".join(traceback.format_exception(reason))
            with suppress(OSError):  # a full disk: the failure itself is what has to be told
                self._log_folder.mkdir(parents=True, exist_ok=True)
                (self._log_folder / f"{node}.traceback.txt").write_text(trace, encoding="utf-8")
