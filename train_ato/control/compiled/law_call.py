"""Call of a law in Python from compiled code."""

from __future__ import annotations

import ctypes
from collections.abc import Callable

import numba.experimental.function_type  # noqa: F401  (permits the type below as an argument)
from numba import types

LEFT = -1
"""Answer for a tick that is left to Python."""
_SIGNATURE = types.int64(types.int64)
_ENTRY = ctypes.CFUNCTYPE(ctypes.c_int64, ctypes.c_int64)


class LawCall(types.WrapperAddressProtocol):  # type: ignore[misc]
    """Argument of a compiled function that calls a function in Python.

    Parameters
    ----------
    function
        Receives the number of the tick in the span, returns 0 or :data:`LEFT`. It must not raise: an exception cannot
        pass through compiled code.
    """

    def __init__(self, function: Callable[[int], int]) -> None:
        self._function, self._entry = function, _ENTRY(function)

    def __call__(self, tick: int) -> int:
        """Call the function without the compiler (``NUMBA_DISABLE_JIT``)."""
        return self._function(tick)

    def __wrapper_address__(self) -> int | None:
        """Return the address of the function."""
        return ctypes.cast(self._entry, ctypes.c_void_p).value

    def signature(self) -> object:
        """Return the types of result and argument."""
        return _SIGNATURE


NO_CALL = LawCall(lambda tick: LEFT)
"""Call of a law with a compiled step."""
