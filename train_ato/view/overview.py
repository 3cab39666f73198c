"""Overview bar of a whole run above the page: its speed, with bands of the law and of the state of the ATO."""

from typing import Any

MAX_POINTS = 800
"""Largest number of points of the speed; a page is rarely wider in pixels."""


class WholeRun:
    """Speed, limit, law and state of the ATO from the start of a run; at most :data:`MAX_POINTS` times.

    Parameters
    ----------
    span
        First and last time of the run [s].

    Attributes
    ----------
    number : int
        Number of changes so far.
    """

    def __init__(self, span: tuple[float, float]) -> None:
        self._span = span
        self._step = max(span[1] - span[0], 0.0) / MAX_POINTS
        self._points: list[tuple[float, float, float]] = []
        self._bands: dict[str, list[tuple[float, str]]] = {"law": [], "ato": []}
        self.number = 0

    def add(self, time: float, speed: float, limit: float, *, law: str, ato: str) -> None:
        """Add a moment [s, km/h, km/h]; one too near to the last moment for a point of its own adds only bands."""
        for name, text in (("law", law), ("ato", ato)):
            band = self._bands[name]
            if text and (not band or band[-1][1] != text):
                band.append((time, text))
                self.number += 1
        if self._points and time < self._points[-1][0] + self._step:
            return
        self._points.append((time, speed, limit))
        self.number += 1
        if len(self._points) > MAX_POINTS:  # a run of unknown duration
            del self._points[1::2]
            self._step = (self._points[-1][0] - self._points[0][0]) / (len(self._points) - 1)

    def columns(self) -> dict[str, list[Any]]:
        """Return the lists of the picture."""
        end = max([self._span[1], *(time for time, _, _ in self._points[-1:])])
        return {
            "span": [self._span[0], end],
            "points": [[round(time, 2), round(speed, 2), _or_none(limit)] for time, speed, limit in self._points],
            **{name: [list(part) for part in band] for name, band in self._bands.items()},
        }


def _or_none(limit: float) -> float | None:
    """Return a limit for the page; None for no limit."""
    return round(limit, 2) if limit == limit else None
