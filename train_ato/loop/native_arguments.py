"""Arguments of a compiled function from a row of numbers: addresses and shapes of arrays, numbers, functions.

A call from Python checks and unpacks every array of its arguments, which takes longer than a tick; a row is read in
compiled code. The arrays of a row must be kept by its owner.
"""

import struct
import warnings
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
from llvmlite import ir
from numba import config, typeof, types
from numba.core import cgutils
from numba.core.errors import NumbaExperimentalFeatureWarning
from numba.extending import NativeValue, intrinsic, models, overload, register_model, unbox

from plant_sim.compiled import direct_call
from train_ato.control.law_call import LawCall


class NativeKind(types.Opaque):  # type: ignore[misc]
    """Type of the arguments in a row.

    Parameters
    ----------
    arguments
        Their types, as that of one tuple.
    """

    def __init__(self, arguments: Any) -> None:
        self.arguments = arguments
        super().__init__(f"NativeKind({arguments})")


register_model(NativeKind)(models.OpaqueModel)


@unbox(NativeKind)  # type: ignore[untyped-decorator]
def _without_value(kind: Any, value: Any, c: Any) -> NativeValue:
    return NativeValue(c.context.get_dummy_value())


def reader_of(function: Any, row: tuple[Any, ...], *others: Any) -> Callable[..., Any]:
    """Return a compiled function of a row and others, without the check of their types in every call.

    Parameters
    ----------
    function
        Its first argument is the kind of the row for :func:`arguments_of`.
    row
        Arguments of the types of those in the row.
    others
        Other arguments of the types of those in a call.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NumbaExperimentalFeatureWarning)  # functions as arguments
        return partial(direct_call(function, NativeKind(typeof(row)), *(typeof(other) for other in others)), None)


def row_numbers(arguments: tuple[Any, ...]) -> Any:
    """Return the row of some arguments, shape (numbers,); without the compiler the arguments."""
    if config.DISABLE_JIT:
        return arguments
    return np.fromiter(_numbers(arguments), dtype=np.int64)


def _numbers(part: Any) -> Iterator[int]:
    if isinstance(part, tuple):
        for inner in part:
            yield from _numbers(inner)
    elif isinstance(part, np.ndarray):
        yield part.ctypes.data
        yield from part.shape
    elif isinstance(part, float):
        yield struct.unpack("q", struct.pack("d", part))[0]
    elif isinstance(part, LawCall):
        yield part.__wrapper_address__() or 0
    else:
        yield int(part)


@intrinsic  # type: ignore[untyped-decorator]
def _arguments_of(typing_context: Any, kind: Any, row: Any) -> Any:
    """Read the numbers of a row as arguments without references to the owners of their arrays."""

    def build(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        numbers = context.make_array(row)(context, builder, given[1]).data
        place = iter(range(1 << 20))

        def number() -> Any:
            return builder.load(cgutils.gep_inbounds(builder, numbers, next(place)))

        def value(part: Any) -> Any:
            if isinstance(part, types.BaseTuple):
                return context.make_tuple(builder, part, [value(inner) for inner in part])
            if isinstance(part, types.Array):
                return array(part)
            if isinstance(part, types.FunctionType):
                found = cgutils.create_struct_proxy(part)(context, builder)
                found[0] = builder.inttoptr(number(), cgutils.voidptr_t)  # its address with the convention of C
                return found._getvalue()
            return builder.bitcast(number(), ir.DoubleType()) if part == types.float64 else number()

        def array(part: Any) -> Any:
            from numba.np.arrayobj import populate_array

            found = context.make_array(part)(context, builder)
            data = builder.inttoptr(number(), context.get_data_type(part.dtype).as_pointer())
            shape = [number() for _ in range(part.ndim)]
            size = context.get_constant(types.intp, context.get_abi_sizeof(context.get_data_type(part.dtype)))
            strides, step = [size] * part.ndim, size
            for axis in reversed(range(part.ndim)):
                strides[axis] = step
                step = builder.mul(step, shape[axis])
            populate_array(found, data=data, shape=shape, strides=strides, itemsize=size, meminfo=None)
            return found._getvalue()

        return value(kind.arguments)

    return kind.arguments(kind, row), build


def arguments_of(kind: Any, row: Any) -> Any:
    """Return the arguments in a row of a kind."""
    return row


overload(arguments_of, inline="always")(lambda kind, row: lambda kind, row: _arguments_of(kind, row))


def _atomic(operation: str) -> Any:
    def build(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        numbers = context.make_array(signature.args[0])(context, builder, given[0]).data
        return builder.atomic_rmw(operation, cgutils.gep_inbounds(builder, numbers, given[1]), given[2], "seq_cst")

    def typed(typing_context: Any, numbers: Any, place: Any, value: Any) -> Any:
        return types.int64(numbers, types.int64, types.int64), build

    return intrinsic(typed)


_add, _exchange = _atomic("add"), _atomic("xchg")


def added(numbers: Any, place: int, value: int) -> Any:
    """Add to one of the numbers that threads share and return it, in one operation of the processor."""
    numbers[place] += value
    return numbers[place]


def exchanged(numbers: Any, place: int, value: int) -> Any:
    """Set one of the numbers that threads share and return its last value, as :func:`added`."""
    last, numbers[place] = numbers[place], value
    return last


overload(added, inline="always")(
    lambda numbers, place, value: lambda numbers, place, value: _add(numbers, place, value) + value
)
overload(exchanged, inline="always")(
    lambda numbers, place, value: lambda numbers, place, value: _exchange(numbers, place, value)
)
