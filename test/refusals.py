"""Refusal of bad input in one line."""

from collections.abc import Iterator
from contextlib import contextmanager

import pytest


@contextmanager
def one_line(match: str, *names: str) -> Iterator[pytest.ExceptionInfo[ValueError]]:
    """Require a ValueError of one line that has a text, as an expression, and names, as a file."""
    with pytest.raises(ValueError, match=match or None) as caught:
        yield caught
    assert "\n" not in str(caught.value) and all(name in str(caught.value) for name in names)
