"""Call of a law or policy from compiled code: over records by its machine code, of a law in Python by a callback."""

import ctypes
from collections.abc import Callable
from typing import Any

from numba import config, types
from numba.experimental.function_type import _get_wrapper_address  # its import permits the type below as an argument
from numba.extending import overload

from train_ato.control.law import RecordLaw

LEFT = -1
"""Answer for a tick that is left to Python."""
_SIGNATURE = types.int64(types.int64, *[types.voidptr] * 4, types.int64, types.int64)
"""Number of the tick, addresses of constants, state, inputs of train and units, numbers of units and state records."""
POLICY = types.float64(*[types.voidptr] * 3, types.int64, types.voidptr)
"""Addresses of rules, state and rows of a policy of the air brake, number of rows, address of the measurement."""
OBSERVER = types.int64(*[types.voidptr] * 2, types.int64, *[types.voidptr] * 2, types.int64)
"""Addresses of constants and state of an observer, number of bodies, addresses of the inputs, number of units."""
_ENTRY = ctypes.CFUNCTYPE(ctypes.c_int64, ctypes.c_int64, *[ctypes.c_void_p] * 4, *[ctypes.c_int64] * 2)


def address(array: Any) -> Any:
    """Return the address of an array in compiled code; without the compiler the array itself."""
    return array


overload(address)(lambda array: lambda array: array.ctypes)


class LawCall(types.WrapperAddressProtocol):  # type: ignore[misc]
    """Argument of a compiled function that calls a law or a policy.

    Parameters
    ----------
    function
        Receives the number of the tick in the span, returns 0 or another number; without the compiler it receives all
        arguments, arrays in place of addresses. It must not raise: an exception cannot pass through compiled code.
    entry
        Compiled function that is called in its place; None for a law in Python.
    signature
        Types of result and arguments, whose first one is that of the function.
    """

    def __init__(self, function: Callable[..., Any], entry: Any = None, signature: Any = _SIGNATURE) -> None:
        self._function, self._signature = function, signature
        if entry is None or config.DISABLE_JIT:
            self._entry = _ENTRY(lambda tick, *_: function(tick))
            self._address = ctypes.cast(self._entry, ctypes.c_void_p).value
        else:
            entry.compile(signature)
            self._address = _get_wrapper_address(entry, signature)

    def __call__(self, *given: Any) -> Any:
        """Call the function without the compiler (``NUMBA_DISABLE_JIT``)."""
        return self._function(*given)

    def __wrapper_address__(self) -> int | None:
        """Return the address of the function."""
        return self._address

    def signature(self) -> object:
        """Return the types of result and arguments."""
        return self._signature


class RecordStep:
    """Law over records in the compiled loop.

    Parameters
    ----------
    law
        The law; the loop changes its records.

    Attributes
    ----------
    constant, state, units : Records
        Constants and state of the law; inputs and outputs of the units.
    couplers : UnitCouplers or None
        Couplers beside the units, of a law that uses their forces.
    uses_shoes : bool
        The law uses the forecast of the shoe forces by itself, beside the feed-forward.
    uses_effect : bool
        The law uses the profile at the effect of the command, beside the feed-forward.
    call : LawCall
        Its guarded step.
    whole : bool
        False: the loop has the other parts of the control stack.
    """

    whole = False

    def __init__(self, law: RecordLaw) -> None:
        self.constant, self.state, self.units, self.couplers = law.constants, law.state, law.units, law.couplers
        step, constants, state = law.form.step, law.constants, law.state
        self.call = LawCall(lambda _t, _p, _s, now, units, *_: step(constants, state, now, units), law.form.entry)
        self.uses_shoes = law.couplers is not None or law.uses_train_forces
        self.uses_effect = law.uses_effect


_STEP = RecordLaw.step


def is_in_loop(law: Any) -> bool:
    """Return True for a law whose form the compiled loop calls; a step that a program replaces is called itself."""
    return isinstance(law, RecordLaw) and law.in_loop and type(law).step is _STEP
