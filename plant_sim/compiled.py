"""Compilation of functions by numba, with a cache on disk if possible."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any

from numba import njit
from numba.core.event import Listener, install_listener

_uncached: list[str] = []


def compiled(
    function: Any = None,
    *,
    uses: tuple[ModuleType, ...] = (),
    into_caller: bool = False,
    allocates: bool = True,
    alone: bool = True,
) -> Any:
    """Compile a function without fast-math, so that every run on one machine gives the same bits.

    The cache is beside the source or, if that is not writable, in the cache folder of the user (``NUMBA_CACHE_DIR``
    sets another). If neither is writable, every process compiles again.

    Parameters
    ----------
    function
        The function; without one, a decorator is returned.
    uses
        Other modules whose compiled functions it calls: a change of their files also makes its cache invalid.
    into_caller
        True for a part of a loop: the compiler puts its code into every caller, which saves the calls and lets it move
        work out of the loop.
    allocates
        False for a function that makes no array: references to its arguments are not counted.
    alone
        False for a function that is compiled as a part of its callers only: the compiler optimises a function again in
        every caller of a caller, so a chain of calls with much code multiplies the time of the compilation.

    Notes
    -----
    A compiled function releases the lock of the interpreter, so that a pool of threads runs several at the same time.
    """
    if function is None:
        return partial(compiled, uses=uses, into_caller=into_caller, allocates=allocates, alone=alone)
    options: dict[str, Any] = {"error_model": "numpy", "nogil": True, "forceinline": into_caller, "_nrt": allocates}
    if not alone:
        options["inline"] = "always"
    try:
        dispatcher = njit(cache=True, **options)(function)
    except RuntimeError as error:
        if "cannot cache" not in str(error):
            raise
        _uncached.append(function.__name__)
        return njit(**options)(function)
    if uses:
        _stamp_with(dispatcher, uses)
    return dispatcher


def _stamp_with(dispatcher: Any, modules: tuple[ModuleType, ...]) -> None:
    """Add the source files of other modules to the stamp of a cached function; numba compares its own file only."""
    file = getattr(getattr(dispatcher, "_cache", None), "_cache_file", None)  # missing with NUMBA_DISABLE_JIT
    if file is not None:
        stamps = [Path(str(module.__file__)).stat() for module in modules]
        file._source_stamp = (file._source_stamp, *((stamp.st_mtime, stamp.st_size) for stamp in stamps))


def results_are_kept() -> bool:
    """Return True if the compiled functions are cached for later processes."""
    return not _uncached


class _FirstCompilation(Listener):  # type: ignore[misc]
    """Listener that calls a function at the first compilation; loading from the cache is no compilation."""

    def __init__(self, call: Callable[[], None]) -> None:
        self._call: Callable[[], None] | None = call

    def on_start(self, event: Any) -> None:
        call, self._call = self._call, None
        if call is not None:
            call()

    def on_end(self, event: Any) -> None:
        """Do nothing."""


@contextmanager
def on_compilation(call: Callable[[], None]) -> Iterator[None]:
    """Call a function once when the compiler begins inside the block."""
    with install_listener("numba:compile", _FirstCompilation(call)):
        yield
