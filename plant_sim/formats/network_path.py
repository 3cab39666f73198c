"""Line along a path through a network of directed tracks, and the data of the tracks by the distance on it.

A foreign infrastructure is a network: tracks with a length and a direction, joined at their ends. A line is the
shortest path between two of its tracks, with both whole. Data of a track have a range on it and perhaps a direction.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

from plant_sim.formats.notes import print_assumption
from plant_sim.number_text import number_text

BEGIN, END = "begin", "end"
TrackEnd = tuple[str, str]
"""Track, and its begin or end."""
Range = tuple[float, float, float]
"""Begin and end [m] on the path, and value."""
STRAIGHT = 1e5
"""Radius beyond which a curve counts as straight [m]."""
BETWEEN = ".."
"""Mark between the two names of a selection ``FROM..TO``."""


@dataclass(slots=True)
class Network:
    """Tracks with their lengths [m], joined ends, and the tracks at named places (stations), with positions [m]."""

    place: str
    lengths: dict[str, float] = field(default_factory=dict)
    joined: dict[TrackEnd, list[TrackEnd]] = field(default_factory=dict)
    named: dict[str, list[tuple[str, float]]] = field(default_factory=dict)

    def join(self, one: TrackEnd, other: TrackEnd) -> None:
        """Join two ends; a train runs over the joint in both directions."""
        self.joined.setdefault(one, []).append(other)
        self.joined.setdefault(other, []).append(one)

    def path(self, selection: str) -> TrackPath:
        """Return the path of a selection ``FROM..TO``, or of the whole network if it has no branch.

        Raises
        ------
        ValueError
            One line: file, selection, problem; remedy.
        """
        if not selection:
            return self._whole()
        first, mark, last = selection.partition(BETWEEN)
        if not mark or not first or not last:
            raise ValueError(f"{self.place}: selection '{selection}': write FROM{BETWEEN}TO, tracks or stations")
        return self._shortest(self._tracks(first), self._tracks(last), selection)

    def _tracks(self, name: str) -> set[str]:
        if name in self.lengths:
            return {name}
        if name in self.named:
            return {track for track, _ in self.named[name]}
        known = ", ".join([*self.named, *self.lengths][:12])
        raise ValueError(f"{self.place}: selection: '{name[:60]}' is no track or station; it has {known} ...")

    def _whole(self) -> TrackPath:
        ends = [(track, end) for track in self.lengths for end in (BEGIN, END)]
        loose = [end for end in ends if not self.joined.get(end)]
        if any(len(self.joined.get(end, ())) > 1 for end in ends) or len(loose) != 2:
            example = BETWEEN.join([*self.named, *self.lengths][:2])
            raise ValueError(
                f"{self.place}: a network of {len(self.lengths)} tracks with branches; name the line as "
                f"FILE:FROM{BETWEEN}TO, tracks or stations, for example '{self.place}:{example}'"
            )
        found = self._shortest({loose[0][0]}, {loose[1][0]}, "")
        if len(found.parts) < len(self.lengths):
            raise ValueError(f"{self.place}: tracks without a connection to the others; name the line FROM{BETWEEN}TO")
        return found

    def _shortest(self, first: Collection[str], last: Collection[str], selection: str) -> TrackPath:
        """Return the shortest path over whole tracks (Dijkstra); states are tracks with the direction of running."""
        waiting = [(self.lengths[track], track, forward, ()) for track in sorted(first) for forward in (True, False)]
        waiting = [entry for entry in waiting if entry[1] not in last or entry[2]]
        heapq.heapify(waiting)
        done: set[tuple[str, bool]] = set()
        while waiting:
            length, track, forward, before = heapq.heappop(waiting)
            if (track, forward) in done:
                continue
            done.add((track, forward))
            way: Any = (*before, (track, forward))
            if track in last:
                return TrackPath(self, way)
            for other, end in self.joined.get((track, END if forward else BEGIN), ()):
                heapq.heappush(waiting, (length + self.lengths[other], other, end == BEGIN, way))
        raise ValueError(f"{self.place}: selection '{selection}': no path between these tracks; name others")


class TrackPath:
    """Path over whole tracks.

    Parameters
    ----------
    network
        The network.
    parts
        Tracks in order, True for a track in its own direction.

    Attributes
    ----------
    length : float
        Length of the path [m].
    """

    def __init__(self, network: Network, parts: Sequence[tuple[str, bool]]) -> None:
        self.network, self.parts = network, tuple(parts)
        self._forward = dict(self.parts)
        self._offset: dict[str, float] = {}
        self.length = 0.0
        for track, _ in self.parts:
            self._offset[track] = self.length
            self.length += network.lengths[track]

    def __contains__(self, track: str) -> bool:
        return track in self._forward

    def forward(self, track: str) -> bool:
        """Return True if the path runs in the direction of a track."""
        return self._forward[track]

    def place(self, track: str, position: float) -> float:
        """Return the distance on the path [m] of a position on a track [m]."""
        along = position if self._forward[track] else self.network.lengths[track] - position
        return self._offset[track] + along

    def extent(self, track: str, begin: float, end: float) -> tuple[float, float]:
        """Return begin and end on the path [m] of a range on a track [m]."""
        one, other = self.place(track, begin), self.place(track, end)
        return (one, other) if one <= other else (other, one)

    def stations(self) -> list[tuple[float, str]]:
        """Return the named places on the path by rising distance [m]; one name once, one name per place."""
        found: dict[float, str] = {}
        for name, spots in self.network.named.items():
            places = sorted(self.place(track, position) for track, position in spots if track in self)
            if places and name not in found.values():
                found.setdefault(places[0], name)
        return sorted(found.items())


def line_data(
    path: TrackPath,
    name: str,
    source: str,
    grades: Sequence[Range],
    radii: Sequence[Range],
    speeds: Sequence[Range],
    sections: dict[str, list[dict[str, Any]]],
) -> dict[str, Any]:
    """Return the data of an own line.

    Parameters
    ----------
    grades, radii, speeds
        Grades in running direction, curve radii [m] (> 0 to the right), permanent speed limits [m/s].
    sections
        Other sections by the key of the line.
    """
    limits = steps(path.length, speeds, min, None)
    data: dict[str, Any] = {
        "schema": "train_ato/line/1",
        "name": name,
        "source": source,
        "end": path.length,
        "grades": [
            {"at": at, "grade": grade} for at, grade in steps(path.length, grades, lambda values: values[-1], 0.0)
        ],
        "curves": [
            {"begin": begin, "end": end, "radius": abs(radius), "side": "right" if radius > 0 else "left"}
            for begin, end, radius in sorted(radii)
            if 0 < abs(radius) < STRAIGHT and end > begin
        ],
        "speed_limits": [{"at": at, "speed": speed} for at, speed in _without_gaps(limits, path)],
        "stops": [{"at": at, "name": station} for at, station in path.stations()],
    }
    return data | sections


def steps(
    length: float, ranges: Iterable[Range], choose: Callable[[list[float]], float], default: float | None
) -> list[tuple[float, float | None]]:
    """Return place [m] and value of every step from 0 to ``length``; ``choose`` takes one of overlapping values."""
    listed = [entry for entry in ranges if entry[1] > entry[0]]
    places = sorted({0.0, length, *(min(max(place, 0.0), length) for entry in listed for place in entry[:2])})
    found: list[tuple[float, float | None]] = []
    for begin, end in pairwise(places):
        middle = 0.5 * (begin + end)
        values = [value for first, last, value in listed if first <= middle < last]
        value = choose(values) if values else default
        if not found or found[-1][1] != value:
            found.append((begin, value))
    return found if any(value != default for _, value in found) else []


def _without_gaps(limits: list[tuple[float, float | None]], path: TrackPath) -> list[tuple[float, float]]:
    """Return the speed limits with the highest one of the path where it has none."""
    known = [speed for _, speed in limits if speed is not None]
    if not known:
        return []
    if len(known) < len(limits):
        at = next(place for place, speed in limits if speed is None)
        print_assumption(
            f"{path.network.place}: no speed limit from {number_text(at)} m of the path on; assumed "
            f"{number_text(3.6 * max(known))} km/h there, its highest one"
        )
    found: list[tuple[float, float]] = []
    for at, speed in limits:
        value = max(known) if speed is None else speed
        if not found or found[-1][1] != value:
            found.append((at, value))
    return found
