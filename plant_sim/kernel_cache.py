"""Compiled kernels on disk, found by content: code, called functions, read constants, processor, versions.

numba finds a kernel by the path of its source file and compares only that file. Here a kernel is one file. Its name has
a hash of all that the compiled code depends on. So copies of the source share a kernel, and a change in a called
function of another file gives another name. Two processes that write at the same time write equal kernels.
"""

import hashlib
import os
import pickle
import secrets
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from enum import EnumMeta
from functools import cache, cached_property, partial
from pathlib import Path
from types import BuiltinFunctionType, CodeType, FunctionType, ModuleType
from typing import Any

import llvmlite
import numba
import numpy as np
from numba import config, types
from numba.core.bytecode import FunctionIdentity
from numba.core.caching import _Cache
from numba.core.compiler import CompileResult
from numba.core.dispatcher import Dispatcher
from numba.core.runtime.nrt import rtsys
from numba.core.serialize import dumps
from numba.misc.appdirs import AppDirs

SHARED = Path(sys.prefix) / "share" / "train_ato" / "kernels"
"""Folder for all users of an installation; it is read and, by the owner, filled with ``NUMBA_CACHE_DIR``."""
UNUSED_S = 30 * 86400.0
"""Time without a use after which the kernel of an earlier source is removed [s]."""
Called = Dispatcher | FunctionType
"""Functions of compiled code: compiled alone, or with their callers (:func:`plant_sim.compiled.also_compiled`)."""
_CHECKSUM = 32
"""Length of the checksum at the begin of a file [bytes]."""
_FORM = 2
"""Form of the kernels: 1 had numbers of functions that two processes could share."""
_HASHES = b"_numba_hashsecret"
"""Symbol of machine code that hashes texts.  Other machine code needs only the memory manager of numba, not the modules
with which numba compiles; these take 0.2 s."""
FunctionIdentity._unique_ids = iter(partial(secrets.randbits, 60), None)
"""Numbers in the names of machine code.  numba counts functions and records from 1 in every process, so kernels of two
processes can have one name for different records, and a third process would call the first it has loaded for both."""


def cache_folders() -> tuple[Path, ...]:
    """Return the folders of kernels: the first is read and written, the others are read."""
    if config.CACHE_DIR:
        return (Path(config.CACHE_DIR),)
    return Path(AppDirs("train_ato", appauthor=False).user_cache_dir) / "kernels", SHARED


def kernels_are_kept() -> bool:
    """Return True if the compiled functions are kept for later processes."""
    return _is_writable(cache_folders()[0])


@cache
def _is_writable(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError:
        return False
    return True


class KernelCache(_Cache):  # type: ignore[misc]
    """Compiled forms of one function on disk, one file for each signature.

    Parameters
    ----------
    dispatcher
        The function, compiled by numba.
    """

    def __init__(self, dispatcher: Dispatcher) -> None:
        self._dispatcher, self._enabled = dispatcher, True

    @property
    def cache_path(self) -> str:
        """Folder that is written."""
        return str(cache_folders()[0])

    def enable(self) -> None:
        """Read and write kernels."""
        self._enabled = True

    def disable(self) -> None:
        """Neither read nor write kernels."""
        self._enabled = False

    def flush(self) -> None:
        """Remove the kernels of this function from the folder that is written."""
        for file in cache_folders()[0].glob(f"{self._name}-*.nbc"):
            file.unlink(missing_ok=True)

    def load_overload(self, sig: Any, target_context: Any) -> CompileResult | None:
        """Return the kernel of a signature, or None."""
        name = self._file_name(sig, target_context.codegen())
        content = name and next(filter(None, (_read(folder / name) for folder in cache_folders())), None)
        if content and _HASHES not in content:
            rtsys.initialize(target_context)
        else:
            target_context.refresh()
        try:
            return CompileResult._rebuild(target_context, *pickle.loads(content)) if content else None
        except (ImportError, AttributeError):  # a type that an earlier version had in another module
            return None

    def save_overload(self, sig: Any, data: CompileResult) -> None:
        """Write the kernel of a signature; a full or removed folder costs later processes a compilation only."""
        name = self._file_name(sig, data.codegen)
        lifted = any(not part.can_cache for part in data.lifted)
        if name and kernels_are_kept() and not lifted and not data.library.has_dynamic_globals:
            try:
                _write(cache_folders()[0] / name, dumps(data._reduce()))
                for file in cache_folders()[0].glob(f"{self._name}-*.nbc"):
                    if file.stat().st_mtime < time.time() - UNUSED_S:
                        file.unlink(missing_ok=True)
            except OSError:
                pass

    @cached_property
    def _name(self) -> str:
        function = self._dispatcher.py_func
        return f"{function.__module__}.{function.__qualname__}".replace("<", "").replace(">", "")

    @cached_property
    def _stamp(self) -> str | None:
        """Hash of all that the function depends on apart from its arguments; None if it has values of unknown kind."""
        try:
            parts = {function: _own_part(function) for function in _reached(self._dispatcher)}
        except TypeError:
            return None
        return _digest("\n".join(sorted(parts.values())))

    def _file_name(self, sig: Any, codegen: Any) -> str | None:
        """Return the name of the file of a signature, or None if the function cannot be kept."""
        if not self._enabled or self._stamp is None:
            return None
        versions = numba.__version__, llvmlite.__version__, np.__version__, sys.version, getattr(sys, "abiflags", "")
        key = _digest(repr((_FORM, str(sig), codegen.magic_tuple(), versions, self._stamp)))
        return f"{self._name}-{key[:32]}.nbc"


def _read(file: Path) -> bytes | None:
    """Return the content of a file, or None for a missing or damaged one; its time becomes that of the last use."""
    try:
        content = file.read_bytes()
    except OSError:
        return None
    checksum, content = content[:_CHECKSUM], content[_CHECKSUM:]
    if hashlib.sha256(content).digest() != checksum:
        return None
    try:
        if file.stat().st_mtime < time.time() - UNUSED_S / 30:
            os.utime(file)
    except OSError:
        pass  # not the owner
    return content


def _write(file: Path, content: bytes) -> None:
    """Write a file as a whole: a reader sees nothing or all of it."""
    with tempfile.NamedTemporaryFile(dir=file.parent, suffix=".part", delete=False) as part:
        try:
            part.write(hashlib.sha256(content).digest() + content)
            part.close()
            Path(part.name).chmod(0o644)
            Path(part.name).replace(file)
        except BaseException:
            Path(part.name).unlink(missing_ok=True)
            raise


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def _reached(first: Called) -> set[Called]:
    """Return the compiled functions that a function calls, directly or not, with itself, without foreign ones."""
    found, rest = {first}, [first]
    while rest:
        called = {value for _, value in _read_values(_plain(rest.pop())) if isinstance(value, Called)}
        called = {value for value in called if not _is_foreign(value.__module__)}
        rest.extend(called - found)
        found |= called
    return found


def _plain(called: Called) -> Callable[..., Any]:
    return called.py_func if isinstance(called, Dispatcher) else called


def _own_part(called: Called) -> str:
    """Return the code of a function, its options and the values it reads, as text."""
    function: Any = _plain(called)
    values = sorted((name, _text_of(value)) for name, value in _read_values(function))
    defaults = [_text_of(value) for value in function.__defaults__ or ()]
    options = sorted((name, repr(value)) for name, value in getattr(called, "targetoptions", {}).items())
    names = function.__module__, function.__qualname__
    return repr((names, _code_text(function.__code__), values, defaults, options))


def _read_values(function: Callable[..., Any]) -> Iterator[tuple[str, Any]]:
    """Yield names and values a function reads from outside: globals, entries of its modules, values of its closure."""
    assert isinstance(function, FunctionType)
    names = set(_names(function.__code__))
    cells = zip(function.__code__.co_freevars, function.__closure__ or (), strict=True)
    values = [(name, cell.cell_contents) for name, cell in cells]
    values += [(name, function.__globals__[name]) for name in names if name in function.__globals__]
    seen: set[str] = set()
    while values:
        place, value = values.pop()
        yield place, value
        if isinstance(value, ModuleType) and value.__name__ not in seen and not _is_foreign(value.__name__):
            seen.add(value.__name__)
            values += [(f"{value.__name__}.{name}", vars(value)[name]) for name in names if name in vars(value)]


def _names(code: CodeType) -> Iterator[str]:
    yield from code.co_names
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _names(constant)


def _code_text(code: CodeType) -> str:
    """Return the byte code with names and constants, without file and line numbers."""
    constants = [_code_text(value) if isinstance(value, CodeType) else repr(value) for value in code.co_consts]
    names = code.co_names, code.co_varnames, code.co_freevars, code.co_cellvars, code.co_argcount, code.co_flags
    return repr((code.co_code, getattr(code, "co_exceptiontable", b""), constants, names))


def _is_foreign(module: str) -> bool:
    """Return True for a module whose content belongs to a version in the name of the file: numpy, Python, numba."""
    return module.partition(".")[0] in {"numpy", "numba", "math", "cmath", "builtins"}


def _text_of(value: Any) -> str:
    """Return a value as text that is equal in every process; raise ``TypeError`` for a value of unknown kind."""
    if isinstance(value, Called):
        return f"function {value.__module__}.{_plain(value).__qualname__}"
    if isinstance(value, ModuleType):
        return f"module {value.__name__}"
    if isinstance(value, types.ExternalFunction):
        return f"symbol {value.symbol}{value.sig}"
    if isinstance(value, (type, BuiltinFunctionType, np.ufunc)) and _is_foreign(getattr(value, "__module__", "numpy")):
        return f"{type(value).__name__} {value.__name__}"
    if isinstance(value, EnumMeta):
        members: dict[str, Any] = dict(value.__members__)
        entries = [(name, _text_of(entry.value)) for name, entry in members.items()]
        return repr((value.__module__, value.__name__, entries))
    if isinstance(value, type) and issubclass(value, tuple) and hasattr(value, "_fields"):
        return repr((value.__module__, value.__name__, value._fields))
    if isinstance(value, np.dtype):
        return repr((value, value.itemsize))
    if isinstance(value, np.ndarray):
        return repr((value.dtype.str, value.shape, value.tobytes()))
    if isinstance(value, tuple):
        return repr((type(value).__name__, [_text_of(entry) for entry in value]))
    if value is None or isinstance(value, (bool, int, float, complex, str, bytes, np.generic)):
        return repr((type(value).__name__, value))
    raise TypeError(type(value).__name__)
