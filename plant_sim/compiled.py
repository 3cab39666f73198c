"""Compilation of functions by numba, with a cache on disk if possible."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any

from numba import config, njit
from numba.core.event import Listener, install_listener
from numba.extending import register_jitable

from plant_sim.kernel_cache import KernelCache


def compiled(function: Any = None, *, into_caller: bool = False, allocates: bool = True, alone: bool = True) -> Any:
    """Compile a function without fast-math, so that every run on one machine gives the same bits.

    The compiled form is kept in the cache folder of the user (``NUMBA_CACHE_DIR`` sets another), see
    :mod:`plant_sim.kernel_cache`. If that is not writable, every process compiles again.

    Parameters
    ----------
    function
        The function; without one, a decorator is returned.
    into_caller
        True for a part of a loop: the compiler puts its code into every caller, which saves the calls and lets it move
        work out of the loop.
    allocates
        False for a function that makes no array: references to its arguments are not counted.
    alone
        False for a function that is compiled only as a part of its callers. The compiler optimises such a function
        again in every caller of a caller. A chain of calls with much code therefore multiplies the time of the
        compilation.

    Notes
    -----
    A compiled function releases the lock of the interpreter, so that a pool of threads runs several at the same time.
    """
    if function is None:
        return partial(compiled, into_caller=into_caller, allocates=allocates, alone=alone)
    options: dict[str, Any] = {"error_model": "numpy", "nogil": True, "forceinline": into_caller, "_nrt": allocates}
    if not alone:
        options["inline"] = "always"
    dispatcher: Any = njit(**options)(function)
    if not config.DISABLE_JIT:  # with NUMBA_DISABLE_JIT it is the function itself
        dispatcher._cache = KernelCache(dispatcher)
    return dispatcher


def direct_call(function: Any, *kinds: Any) -> Any:
    """Return a compiled function for arguments of some types of numba, at which it does not look in a call.

    The look takes 0.5 us for four arrays of records, and milliseconds for many arrays in named tuples.
    """
    if config.DISABLE_JIT:
        return function
    function.compile(kinds)
    return function.overloads[kinds].entry_point


also_compiled: Any = register_jitable(forceinline=True)
"""Decorator of a function that stays one of Python, and is a part of the compiled functions that call it."""


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
