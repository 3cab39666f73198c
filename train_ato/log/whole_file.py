"""Writing of files: a small one as a whole or not at all, errors with the name of the file."""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Give the errors of the block the name of the file: the error of a full disk has none.

    Raises
    ------
    OSError
        With the name of the file.
    """
    try:
        yield
    except OSError as error:
        reason = os.strerror(error.errno) if error.errno else str(error)
        raise OSError(error.errno or 0, reason, str(path)) from None


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield the path of a new file that takes the name ``path`` at the end of the block, so that none is written half.

    Raises
    ------
    OSError
        With the name of the file; an earlier file of that name is unchanged.
    """
    temporary = path.with_name(f".{path.name}.new")
    try:
        with writing(path):
            yield temporary
            temporary.replace(path)
    except OSError:
        with suppress(OSError):
            temporary.unlink()
        raise


def write_whole(path: Path, text: str) -> None:
    """Write a text file as a whole or not at all, as :func:`replacing`."""
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8", errors="backslashreplace")
