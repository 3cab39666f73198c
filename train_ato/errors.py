"""First failure of a run: node and reason in one line, traceback in a file."""

from __future__ import annotations

import traceback
from contextlib import suppress
from pathlib import Path
from typing import Any

_OWN = ("train_ato", "plant_sim")


def of_own_code(error: BaseException) -> bool:
    """Return true for an exception from code of this project below the frame that caught it.

    Other exceptions come from a library during the processing of an external message.
    """
    frames = [frame.f_globals.get("__name__", "") for frame, _ in traceback.walk_tb(error.__traceback__)]
    return any(name.partition(".")[0] in _OWN for name in frames[1:])


class RunFailed(Exception):
    """Failure of a run; the message has node and reason in one line.

    Attributes
    ----------
    run : Run or None
        Record of the run up to its end, for runs started by :func:`train_ato.run`.
    printed : bool
        True: the command has printed the message.
    """

    def __init__(self, message: object = "", run: Any = None) -> None:
        super().__init__(message)
        self.run = run
        self.printed = False


class RunInterrupted(RunFailed, KeyboardInterrupt):
    """End of a run by Ctrl-C; ``run`` is its record up to the end."""


class NodeFault(ValueError):
    """Fault of another node or program, found by its messages.

    Attributes
    ----------
    node : str
        Its name.
    """

    def __init__(self, node: str, reason: str) -> None:
        super().__init__(reason)
        self.node = node


class FirstFailure:
    """First failure in this process; it ends the run.

    Parameters
    ----------
    log_folder
        Folder of the traceback file for developers; None: no file.
    """

    def __init__(self, log_folder: Path | None = None) -> None:
        self._log_folder = log_folder
        self.failure: str | None = None

    def fail(self, node: str, reason: str | BaseException) -> None:
        """Store the failure of a node; later failures are consequences and are ignored."""
        if self.failure is not None:
            return
        node = getattr(reason, "node", node)
        text = " ".join(str(reason).split()) or type(reason).__name__
        if isinstance(reason, BaseException) and not isinstance(reason, (ValueError, OSError, RunFailed)):
            text = f"{type(reason).__name__}: {text}"
        self.failure = f"node {node} failed: {text}"
        if isinstance(reason, BaseException) and self._log_folder is not None:
            trace = "".join(traceback.format_exception(reason))
            with suppress(OSError):  # a full disk must not hide the failure itself
                self._log_folder.mkdir(parents=True, exist_ok=True)
                (self._log_folder / f"{node}.traceback.txt").write_text(trace, encoding="utf-8")
