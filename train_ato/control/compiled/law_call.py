"""Call of a law or policy from compiled code: over records by its machine code, of a law in Python by a callback."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from typing import Any

from numba import config, types
from numba.experimental.function_type import _get_wrapper_address  # its import permits the type below as an argument

LEFT = -1
"""Answer for a tick that is left to Python."""
_SIGNATURE = types.int64(types.int64, *[types.voidptr] * 4, types.int64)
"""Number of the tick, addresses of constants, state and inputs of the train and of the units, number of units."""
POLICY = types.float64(*[types.voidptr] * 3, types.int64, types.voidptr)
"""Addresses of rules, state and rows of a policy of the air brake, number of rows, address of the measurement."""
_ENTRY = ctypes.CFUNCTYPE(ctypes.c_int64, ctypes.c_int64, *[ctypes.c_void_p] * 4, ctypes.c_int64)


class LawCall(types.WrapperAddressProtocol):  # type: ignore[misc]
    """Argument of a compiled function that calls a law or a policy.

    Parameters
    ----------
    function
        Receives the number of the tick in the span, returns 0 or another number. It must not raise: an exception cannot
        pass through compiled code.
    entry
        Compiled function that is called in its place; None for a law in Python.
    signature
        Types of result and arguments, whose first one is that of the function.
    """

    def __init__(self, function: Callable[[Any], Any], entry: Any = None, signature: Any = _SIGNATURE) -> None:
        self._function, self._signature = function, signature
        if entry is None or config.DISABLE_JIT:
            self._entry = _ENTRY(lambda tick, *_: function(tick))
            self._address = ctypes.cast(self._entry, ctypes.c_void_p).value
        else:
            entry.compile(signature)
            self._address = _get_wrapper_address(entry, signature)

    def __call__(self, first: Any, *_: Any) -> Any:
        """Call the function without the compiler (``NUMBA_DISABLE_JIT``)."""
        return self._function(first)

    def __wrapper_address__(self) -> int | None:
        """Return the address of the function."""
        return self._address

    def signature(self) -> object:
        """Return the types of result and arguments."""
        return self._signature


NO_CALL = LawCall(lambda tick: LEFT)
"""Call of a law with a compiled step."""
