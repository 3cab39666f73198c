"""Process of a standalone node, and its report."""

import contextlib
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Mapping
from pathlib import Path

from train_ato.messages.topics import Role
from train_ato.program.arguments import BAD_INPUT
from train_ato.ros.graph.domain_lock import inherited_locks
from train_ato.ros.graph.environment import variables
from train_ato.ros.nodes.answer_watch import LEASE_S
from train_ato.ros.standalone.notices import FAILURE, INTERRUPTION, LAST_COUNT, NOTE, OUTSIDE, Notice

LEAVING_S = 5.0
"""Wall time for a node to end after a failure of the run [s]."""
READ_S = 5.0
"""Wall time for the rest of the report of an ended process [s]."""
STOPPED_S = 1.0
"""Shortest time of a stopped process that a failure names [s]; a shorter one is no reason for it."""
_PACKAGE_ROOT = str(Path(__file__).resolve().parents[3])


class NodeProcess:
    """Process of a standalone node, and the thread that reads its report.

    Parameters
    ----------
    role
        Node in the process.
    arguments
        Options of the node.
    domain
        ROS domain.
    log_folder
        Folder of its standard error.
    suffix
        End of the name of this file.

    Attributes
    ----------
    counts : dict
        Integers that the node has printed, by name.
    reported : float
        Monotonic wall time of the last report [s].
    lost : bool
        True after the report of its failure to the plant.
    remark : str
        End of the text of its failure.
    joined : bool
        True after the notice to the new process of a node to join the run.
    stopped : float
        Longest wall time for which the process was stopped by a signal or a debugger [s].
    """

    def __init__(self, role: Role, arguments: list[str], domain: int, log_folder: Path, suffix: str = "") -> None:
        self.role = role
        self.counts: dict[str, list[int]] = {}
        self.reported = time.monotonic()
        self.lost = False
        self.remark = ""
        self.joined = False
        self.stopped = self._since = 0.0
        self._hung = False
        self._said: dict[str, str] = {}
        self._errors = log_folder / f"{role.value}{suffix}.stderr.txt"
        environment = {**os.environ, **variables(domain, log_folder)}
        paths = [_PACKAGE_ROOT, *filter(None, environment.get("PYTHONPATH", "").split(os.pathsep))]
        environment["PYTHONPATH"] = os.pathsep.join(paths)
        command = [sys.executable, "-m", "train_ato.ros.standalone", role.value, *arguments, "--attached"]
        with self._errors.open("wb") as errors:
            # a separate session, so that Ctrl-C of the terminal reaches only this process
            self.process = subprocess.Popen(
                command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=errors,
                env=environment,
                start_new_session=True,
                pass_fds=inherited_locks(),
                text=True,
            )
        self._reader = threading.Thread(target=self._read, name=f"report of {role.value}", daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            if line.startswith(NOTE):
                sys.stderr.write(line.removeprefix(NOTE))
                continue
            if line.startswith((FAILURE, INTERRUPTION, OUTSIDE)):
                self._said[line.partition(" ")[0]] = line.partition(" ")[2].strip()
                continue
            name, _, values = line.rpartition(":")
            with contextlib.suppress(ValueError):  # a print of a law or a library
                self.counts[name] = [int(value) for value in values.split()]
                self.reported = time.monotonic()

    @property
    def tick(self) -> int:
        """Number of complete ticks of the plant."""
        return self.counts.get("tick", [0])[0]

    @property
    def interruption(self) -> str | None:
        """Signal or request that ended the run of a plant; None without one."""
        return self._said.get(INTERRUPTION.strip())

    @property
    def outside(self) -> str:
        """Name of the external node at the recorder, "" as long as it is unknown."""
        return self._said.get(OUTSIDE.strip(), "")

    @property
    def last_error(self) -> str:
        """Failure that the node has printed, otherwise the error of its last traceback, or its last line."""
        if self.process.poll() is not None:
            self._reader.join(READ_S)
        if failure := self._said.get(FAILURE.strip()):
            return failure
        printed = self._errors.read_text(errors="replace")
        _, traced, text = printed.rpartition("Traceback (most recent call last):\n")
        lines = [line for line in text.splitlines() if line.strip() and not (traced and line[0].isspace())]
        named = [line for line in printed.splitlines() if line.startswith("node ") and " failed: " in line]
        return (
            (named[-1:] or (lines[:1] if traced else lines[-1:]) or [""])[0]
            .strip()
            .removeprefix(f"{self.role.value}: ")
        )

    @property
    def _reported_all(self) -> bool:
        """True if an ended process has printed its last count: its work was done."""
        self._reader.join(READ_S)
        return LAST_COUNT in self.counts

    @property
    def failure(self) -> str | None:
        """Failure of the node with its reason; None while it runs, after a regular end and after its last count."""
        status = self.process.poll()
        if status is None or (status == 0 and self._reported_all):
            return None
        named = self.last_error if self.last_error.startswith("node ") else ""
        if status < 0 and not named and self._reported_all:
            return None
        if self._hung:
            text = named or "its process did not end with the run"
        elif status == 0:
            text = "its process ended before the run, with status 0"
        elif status < 0:
            text = f"its process was ended by {signal.Signals(-status).name}"
        else:
            text = self.last_error or f"its process ended with status {status}"
        return f"{'' if text.startswith('node ') else f'node {self.role.value} failed: '}{text}{self.remark}"

    @property
    def crashed(self) -> bool:
        """True if the process has ended by a signal or with a status other than 0, without the report of a failure."""
        status = self.process.poll()
        if status is None or status == BAD_INPUT or (status <= 0 and self._reported_all):
            return False
        return status <= 0 or not self.last_error.startswith("node ")

    def look(self) -> None:
        """Measure for how long the process is stopped; to be called again and again."""
        with contextlib.suppress(OSError):
            state = Path(f"/proc/{self.process.pid}/stat").read_text(errors="replace").rpartition(") ")[2][:1]
            now = time.monotonic()
            self._since = (self._since or now) if state in ("T", "t") else 0.0
            self.stopped = max(self.stopped, now - self._since if self._since else 0.0)

    def send(self, notice: Notice) -> None:
        """Write a notice to the standard input of the node."""
        assert self.process.stdin is not None
        with contextlib.suppress(OSError):
            self.process.stdin.write(f"{notice.line}\n")
            self.process.stdin.flush()

    def release(self) -> None:
        """Close the standard input of the node; the node then ends the run."""
        assert self.process.stdin is not None
        with contextlib.suppress(OSError):
            self.process.stdin.close()

    def ends_within(self, patience: float) -> bool:
        """Wait for the end of the process for ``patience`` [s]; return True if it has ended."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self.process.wait(timeout=patience)
        return self.process.poll() is not None

    def end(self, patience: float) -> None:
        """Wait for the end of the process; after ``patience`` [s] end it by SIGKILL.

        A node that has sent its last count has done its work: then this is no failure.
        """
        try:
            self.process.wait(timeout=patience)
        except subprocess.TimeoutExpired:
            self._hung = True
            self.process.kill()
            self.process.wait()
        self._reader.join(timeout=LEAVING_S)
        assert self.process.stdout is not None
        self.process.stdout.close()


def with_stop(failure: str, nodes: Mapping[Role, NodeProcess]) -> str:
    """Return a failure without an answer or a report of a node, with the time for which its process was stopped."""
    role, _, reason = failure.removeprefix("node ").partition(" failed: no ")
    stopped = next((node.stopped for node in nodes.values() if reason and node.role.value == role), 0.0)
    if stopped < STOPPED_S:
        return failure
    cause = f"its process was stopped for {stopped:.1f} s (SIGSTOP, debugger); after {LEASE_S:g} s the others drop it"
    return f"{failure}; {cause}; a run in one process, without --processes, goes on after a stop"
