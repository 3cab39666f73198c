"""Text of a number for people: no exponent where digits are as short."""

from __future__ import annotations

LARGEST_WRITTEN_OUT = 1e15
"""Magnitude from which a number keeps its exponent: more digits than a float has."""


def number_text(value: float, digits: int = 6) -> str:
    """Return a number with its significant digits; all digits before the point are written.

    Parameters
    ----------
    value
        Number, also infinite or nan.
    digits
        Significant digits of a number with fewer digits before the point.

    Examples
    --------
    >>> number_text(1e6), number_text(0.25), number_text(999.7, digits=3), number_text(1234.5, digits=3)
    ('1000000', '0.25', '1000', '1234')
    """
    text = f"{value:.{digits}g}"
    return f"{value:.0f}" if "e+" in text and abs(value) < LARGEST_WRITTEN_OUT else text
