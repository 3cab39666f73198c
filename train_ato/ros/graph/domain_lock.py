"""Lock of a ROS domain in one network: an abstract Unix socket, whose name the network namespace owns.

Two containers with one network see the nodes of each other, and share the names of abstract sockets; their folders for
temporary files differ.  The kernel removes the name with the last process that has the socket.
"""

import errno
import re
import socket
from contextlib import suppress
from pathlib import Path

TRAINS = "/"
"""Namespace in a second lock of the program that holds a domain for trains in namespaces: it has no nodes itself."""
_held: set[int] = set()
"""File descriptors of the locks of this process."""


def inherited_locks() -> tuple[int, ...]:
    """Return the file descriptors of the locks of this process, for the processes of its nodes.

    A node outlives a killed run by about two seconds: the domain stays locked until the last node has ended.
    """
    return tuple(_held)


def locked_runs() -> set[tuple[int, str]]:
    """Return the domains of this network with a lock, each with the namespace of the lock, "" for none."""
    with suppress(OSError):
        names = Path("/proc/net/unix").read_text(encoding="utf-8", errors="replace")
        return {(int(domain), space) for domain, space in re.findall(r"@train_ato-domain-(\d+)(\S*)", names)}
    return set()


class DomainLock:
    """Lock of one domain; the kernel releases it at the end of the process and of the processes that inherit it.

    Parameters
    ----------
    domain
        ROS domain.
    namespace
        Namespace of the nodes of one of several trains in the domain; "" for none.
    """

    def __init__(self, domain: int, namespace: str = "") -> None:
        self.name = f"train_ato-domain-{domain}{namespace}"
        self._socket: socket.socket | None = None

    def acquire(self) -> bool:
        """Acquire the lock; return False if another process of this network holds it."""
        found = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        try:
            found.bind(f"\0{self.name}")
        except OSError as error:
            found.close()
            if error.errno != errno.EADDRINUSE:
                raise
            return False
        self._socket = found
        _held.add(found.fileno())
        return True

    def release(self) -> None:
        """Release the lock."""
        if self._socket is not None:
            _held.discard(self._socket.fileno())
            self._socket.close()
            self._socket = None

    @property
    def held(self) -> bool:
        """True if another process, or another lock of this one, holds the lock."""
        if not self.acquire():
            return True
        self.release()
        return False
