"""Remains of a run with one process per node: processes, shared memory, locks, tracebacks."""

from pathlib import Path

from waiting import wait_for

from train_ato.ros.graph import shared_memory
from train_ato.ros.graph.domain_lock import inherited_locks


def processes_of(folder: Path) -> dict[str, int]:
    """Return the node processes of a run by their role; they carry its scenario in their command line."""
    found = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                words = (entry / "cmdline").read_bytes().decode(errors="replace").split("\0")
            except OSError:
                continue
            if str(folder / "scenario.yaml") in words:
                found[words[words.index("train_ato.ros.standalone") + 1]] = int(entry.name)
    return found


def check_nothing_left(folder: Path) -> None:
    """Fail if a run of this process has left a process, shared memory, a lock or a traceback."""
    assert not processes_of(folder)
    assert not inherited_locks()
    wait_for(lambda: not shared_memory.abandoned(), "the end of the shared memory")
    for path in folder.glob("log/*.stderr.txt"):
        assert "Traceback" not in path.read_text(errors="replace"), path
