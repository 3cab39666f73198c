"""Messages of one run, in memory or in a run folder."""

from __future__ import annotations

import shutil
import tempfile
from contextlib import ExitStack
from pathlib import Path

from train_ato.log.compression import DEFAULT
from train_ato.log.run_folder import Encoder, RunFolder
from train_ato.loop.result import RunResult
from train_ato.loop.setup import RunSetup
from train_ato.messages.tick_block import TickBlock

MESSAGES_IN_MEMORY = 100_000
"""Maximum number of messages in memory: about 100 MB for a train of 106 vehicles, 18 minutes at 10 Hz."""


class RunRecord:
    """Sink for the messages of the engine; creates the run folder.

    Parameters
    ----------
    setup
        The run.
    folder
        Run folder for all messages.  None: messages in memory; a temporary folder, removed with this object, is created
        for tables, files, or too many messages.
    compression
        Compression of the log: ``none``, ``fast`` or ``small``.
    """

    def __init__(self, setup: RunSetup, folder: RunFolder | None = None, compression: str = DEFAULT) -> None:
        self._compression = compression
        self._setup = setup
        self._folder = folder
        self._scratch = tempfile.TemporaryDirectory(prefix="train_ato_run_") if folder is None else None
        self._messages: list[tuple[str, object, int]] = []
        self._log = ExitStack()
        self._sink: Encoder | None = None
        if folder is not None:
            folder.begin(setup)

    @property
    def lasting(self) -> Path | None:
        """Path of the run folder; None for a temporary one."""
        return None if self._folder is None or self._scratch is not None else self._folder.path

    @property
    def log_folder(self) -> Path:
        """Folder for the traceback of a failure; it need not exist."""
        if self._scratch is not None:
            return Path(self._scratch.name) / "run" / "log"
        assert self._folder is not None
        return self._folder.path / "log"

    def add(self, topic: str, message: object, stamp: int) -> None:
        """Add one message."""
        if self._sink is not None:
            self._sink.add(topic, message, stamp)
            return
        self._messages.append((topic, message, stamp))
        if len(self._messages) >= MESSAGES_IN_MEMORY:
            self.begin_log()

    def add_ticks(self, block: TickBlock) -> bool:
        """Write the messages of a block of ticks to the open log; return False without one, for single messages."""
        return self._sink is not None and self._sink.add_ticks(block)

    def folder(self) -> RunFolder:
        """Return the run folder; create a temporary one if there is none."""
        if self._folder is None:
            path = self.log_folder.parent
            path.mkdir(exist_ok=True)
            self._folder = RunFolder(path)
            self._folder.begin(self._setup)
        return self._folder

    def begin_log(self) -> None:
        """Open the log and write the messages in memory."""
        self._sink = self._log.enter_context(self.folder().sink(self._setup, compression=self._compression))
        messages, self._messages = self._messages, []
        for message in messages:
            self._sink.add(*message)

    def close_log(self) -> None:
        """Close the log if it is open."""
        self._log.close()

    def counted(self, outcome: RunResult) -> RunResult:
        """Return the result of the run, as failed if messages are missing in the log."""
        return outcome if self._sink is None else outcome.checked_against(self._sink.counts)

    def written(self) -> RunFolder:
        """Return the run folder with its log."""
        if not self.folder().recorded:
            self.begin_log()
            self.close_log()
        return self.folder()

    def settle(self, folder: RunFolder) -> None:
        """Replace the run folder by its copy."""
        if self._scratch is not None:
            self._scratch.cleanup()
            self._scratch = None
        self._folder = folder


def copy_run(source: Path, path: Path, name: str) -> RunFolder:
    """Copy a run folder.

    Raises
    ------
    ValueError
        If the folder exists and is not empty, or is not writable.
    """
    target = RunFolder.make(path, name, "save")
    try:
        shutil.copytree(source, target.path, dirs_exist_ok=True)
    except (OSError, shutil.Error) as error:
        target.discard()
        raise ValueError(f"save {path}: cannot be written ({error}); give a writable folder") from None
    return target
