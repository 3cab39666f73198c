"""Lock of a ROS domain on this machine, by a file with the same path for all users and environments.

The package ``filelock`` opens its file with ``O_CREAT``.  With ``fs.protected_regular`` the kernel refuses that in a
folder with the sticky bit for a file of another user; after a killed run of that user the domain would stay held.
"""

from __future__ import annotations

import errno
import fcntl
import os
import stat
from contextlib import suppress
from pathlib import Path

LOCK_FOLDER = Path("/tmp")
"""Folder of the lock files.  It does not depend on ``TMPDIR``: runs with different ones must find each other."""


_held: set[int] = set()
"""File descriptors of the locks of this process."""


def inherited_locks() -> tuple[int, ...]:
    """Return the file descriptors of the locks of this process, for the processes of its nodes.

    A node outlives a killed run by about two seconds: the domain stays locked until the last node has ended.
    """
    return tuple(_held)


class DomainLock:
    """Lock of one domain; the kernel releases it at the end of the process and of the processes that inherit it.

    Parameters
    ----------
    domain
        ROS domain.

    Attributes
    ----------
    path : Path
        Lock file.
    """

    def __init__(self, domain: int) -> None:
        self.path = LOCK_FOLDER / f"train_ato-domain-{domain}.lock"
        self._file: int | None = None

    def acquire(self) -> bool:
        """Acquire the lock; return False if another process holds it, or removes its file at the same time.

        Raises
        ------
        ValueError
            If the path is not a plain file, for example a symbolic link: it is neither followed nor locked.
        """
        try:
            file = self._open()
        except OSError as error:
            if error.errno in (errno.ELOOP, errno.EISDIR, errno.ENXIO):
                raise ValueError(f"{self.path}: is not a plain file; remove it") from None
            return False
        try:
            if not stat.S_ISREG(os.fstat(file).st_mode):
                raise ValueError(f"{self.path}: is not a plain file; remove it")
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if os.fstat(file).st_ino != self.path.lstat().st_ino:
                raise BlockingIOError
        except BaseException as error:
            os.close(file)
            if isinstance(error, OSError):
                return False
            raise
        self._file = file
        _held.add(file)
        return True

    def _open(self) -> int:
        """Open or create the file; a file of another user is opened without permission to create it."""
        flags = os.O_RDWR | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
        with suppress(FileNotFoundError):
            return os.open(self.path, flags)
        file = os.open(self.path, flags | os.O_CREAT | os.O_EXCL, 0o666)
        with suppress(OSError):
            os.fchmod(file, 0o666)  # other users lock it after the end of this process
        return file

    def release(self) -> None:
        """Remove the file, then release the lock."""
        if self._file is not None:
            with suppress(OSError):
                self.path.unlink()
            _held.discard(self._file)
            os.close(self._file)
            self._file = None

    @property
    def held(self) -> bool:
        """True if another process holds the lock."""
        try:
            if not stat.S_ISREG(self.path.lstat().st_mode):
                return False
        except OSError:
            return False
        if not self.acquire():
            return True
        self.release()
        return False
