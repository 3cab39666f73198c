"""How functions are compiled, and whether the result is kept."""

from __future__ import annotations

from typing import Any

from numba import njit

_alone: list[str] = []


def compiled(function: Any) -> Any:
    """Compile without fast-math: the same bits on every run of one machine.

    The result is kept beside the source or, if that is not writable, in the user's cache folder (``NUMBA_CACHE_DIR``
    names another).  Where none of them can be written every process compiles for itself.
    """
    try:
        return njit(cache=True, error_model="numpy")(function)
    except RuntimeError as error:
        if "cannot cache" not in str(error):
            raise
        _alone.append(function.__name__)
        return njit(error_model="numpy")(function)


def results_are_kept() -> bool:
    """Tell whether later processes find what this one compiles."""
    return not _alone
