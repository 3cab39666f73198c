"""Line along a path through a network of directed tracks, and the data of the tracks by the distance on it.

A foreign infrastructure is a network: tracks with a length and a direction, joined at their ends. A line is the
shortest path between two of its tracks, with both whole. Data of a track have a range on it and perhaps a direction.
A path may pass a track twice (a balloon loop); its data then hold at both passages.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from plant_sim.formats.fields import print_assumption
from plant_sim.input_error import build_model
from plant_sim.line import ENDING, Line
from plant_sim.units import number_text

BEGIN, END = "begin", "end"
TrackEnd = tuple[str, str]
"""Track, and its begin or end."""
ROUNDING = 1.0
"""Length up to which an overlap, or a place beyond a track, counts as rounding of the file [m]."""
SHORT = 2.0
"""Length of a range below which its positions are probably in another unit [m]."""
SAME_STATION = 2000.0
"""Largest distance between two tracks of one station that a train passes one after the other [m]."""
SHARPEST, STRAIGHT = 5.0, 1e5
"""Least radius of a curve, and that beyond which it counts as straight [m]."""
BETWEEN = ".."
"""Mark between the two names of a selection ``FROM..TO``."""


class Range(NamedTuple):
    """Value from begin to end [m] on a path; ``entry`` is its place in the file, for messages."""

    begin: float
    end: float
    value: float
    entry: str = ""


class Passage(NamedTuple):
    """Stretch of a path [m] where it passes a range of a track; True in the direction of the track."""

    begin: float
    end: float
    forward: bool


@dataclass(slots=True)
class Network:
    """Tracks with their lengths [m], joined ends, and the tracks at named places (stations), with positions [m]."""

    place: str
    lengths: dict[str, float] = field(default_factory=dict)
    joined: dict[TrackEnd, list[TrackEnd]] = field(default_factory=dict)
    named: dict[str, list[tuple[str, float]]] = field(default_factory=dict)
    groups: dict[str, tuple[str, ...]] = field(default_factory=dict)
    """Tracks by the name of the chain that they form; not of a railway place."""

    def join(self, one: TrackEnd, other: TrackEnd, *, both: bool = True) -> None:
        """Join two ends; a train runs over the joint in both directions, or only from the first end to the other."""
        for here, there in ((one, other), (other, one))[: 2 if both else 1]:
            if there not in self.joined.setdefault(here, []):
                self.joined[here].append(there)

    def path(self, selection: str, *, against: bool = False) -> TrackPath:
        """Return the path ``FROM..TO`` or ``FROM..VIA..TO``, or of a network without a branch; ``against`` turns it."""
        if not selection:
            found = self._whole()
        else:
            names = [name.strip() for name in selection.split(BETWEEN)]
            if len(names) < 2 or not all(names):
                raise ValueError(
                    f"{self.place}: selection '{selection}': write FROM{BETWEEN}TO, tracks or stations, or "
                    f"FROM{BETWEEN}VIA{BETWEEN}TO"
                )
            first, last = names[0], names[-1]
            found = self._shortest([self._tracks(name) for name in names], selection)
            for name, verb, (track, _) in ((first, "begins", found.parts[0]), (last, "ends", found.parts[-1])):
                if len(tracks := sorted(self._tracks(name))) > 1:
                    print_assumption(
                        f"{self.place}: '{name}' is on the tracks {', '.join(tracks[:8])}; the path {verb} on {track}"
                    )
        return found.reversed() if against else found

    def _tracks(self, name: str) -> set[str]:
        if name in self.lengths:
            return {name}
        if set(self.groups.get(name, ())) & self.lengths.keys():
            return set(self.groups[name]) & self.lengths.keys()
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
        found = self._shortest([{loose[0][0]}, {loose[1][0]}], "")
        if len(found.parts) < len(self.lengths):
            raise ValueError(f"{self.place}: tracks without a connection to the others; name the line FROM{BETWEEN}TO")
        return found

    def _shortest(self, places: Sequence[Collection[str]], selection: str) -> TrackPath:
        """Return the shortest path over whole tracks by places in their order (Dijkstra).

        States are tracks with the direction of running and the number of places passed; a train does not turn.
        """
        waiting: list[tuple[float, str, bool, int, Any]] = [
            (self.lengths[track], track, forward, 1, ())
            for track in sorted(places[0])
            for forward in (True, False)
            if forward or len(places) > 2 or track not in places[-1]
        ]
        heapq.heapify(waiting)
        done: set[tuple[str, bool, int]] = set()
        while waiting:
            length, track, forward, passed, before = heapq.heappop(waiting)
            while passed < len(places) and track in places[passed]:
                passed += 1
            if (track, forward, passed) in done:
                continue
            done.add((track, forward, passed))
            way = (*before, (track, forward))
            if passed == len(places):
                return TrackPath(self, way)
            for other, end in self.joined.get((track, END if forward else BEGIN), ()):
                heapq.heappush(waiting, (length + self.lengths[other], other, end == BEGIN, passed, way))
        turn = self._turn(places) if len(places) > 2 else None
        if turn is None:
            raise ValueError(f"{self.place}: selection '{selection}': no path between these tracks; name others")
        names = selection.split(BETWEEN)
        one, other = BETWEEN.join(names[: turn + 1]), BETWEEN.join(names[turn:])
        raise ValueError(
            f"{self.place}: selection '{selection}': a train turns at '{names[turn]}', and a line has one "
            f"direction; run it as two lines, {self.place}:{one} and {self.place}:{other}"
        )

    def _turn(self, places: Sequence[Collection[str]]) -> int | None:
        """Return the number of the first place between two paths that only a turn there joins; None without one."""
        for number in range(1, len(places) - 1):
            with suppress(ValueError):
                self._shortest(places[: number + 1], "")
                self._shortest(places[number:], "")
                return number
        return None


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
        self._passages: dict[str, list[tuple[float, bool]]] = {}
        self.length = 0.0
        for track, forward in self.parts:
            self._passages.setdefault(track, []).append((self.length, forward))
            self.length += network.lengths[track]

    def __contains__(self, track: str) -> bool:
        return track in self._passages

    def reversed(self) -> TrackPath:
        """Return the path over the same tracks from its end to its begin.

        A joint that a train runs over in the other direction only is refused.
        """
        found = TrackPath(self.network, [(track, not forward) for track, forward in reversed(self.parts)])
        found.check_joints()
        return found

    def check_joints(self) -> None:
        """Refuse a path over a joint that does not exist, or that a train runs over in the other direction only."""
        for (track, forward), (other, onward) in pairwise(self.parts):
            if (other, BEGIN if onward else END) not in self.network.joined.get((track, END if forward else BEGIN), ()):
                raise ValueError(
                    f"{self.network.place}: the path is not navigable from {track} to {other}; name another one "
                    f"FROM{BETWEEN}TO in this direction"
                )

    def passages(self, track: str, begin: float, end: float, entry: str) -> list[Passage]:
        """Return every passage of a range on a track [m] by the path; none for a track beside it.

        Parameters
        ----------
        entry
            Place of the range in the file, for messages.

        Raises
        ------
        ValueError
            One line for a track that does not exist, and for a range beyond a track on the path.
        """
        if track not in self.network.lengths:
            raise ValueError(f"{entry}: track '{track[:60]}': no track of this network; correct or remove the entry")
        length = self.network.lengths[track]
        if track not in self:
            return []
        low, high = min(begin, end), max(begin, end)
        if low < -ROUNDING or high > length + ROUNDING:
            raise ValueError(
                f"{entry}: from {number_text(begin)} to {number_text(end)} m: beyond the track {track[:60]} of "
                f"{number_text(length)} m; end it there"
            )
        low, high = max(low, 0.0), min(high, length)
        if high <= low:
            print_assumption(f"{entry}: it has no length and no effect")
            return []
        if high - low < SHORT < length:
            print_assumption(f"{entry}: it is {number_text(high - low)} m long; positions on a track are in m")
        return [
            Passage(at + low, at + high, True) if forward else Passage(at + length - high, at + length - low, False)
            for at, forward in self._passages[track]
        ]

    def _spots(self, track: str, position: float) -> list[float]:
        """Return the distances on the path [m] of a position on a track [m]."""
        length = self.network.lengths[track]
        return [at + (position if forward else length - position) for at, forward in self._passages.get(track, ())]

    def without_power(self, sections: Iterable[Range], what: str) -> list[tuple[float, float]]:
        """Return the stretches without traction power [m], by sections of value 1 with power and 0 without.

        The places beside the sections count if one of them has power; a message names them as without a ``what``.
        """
        found, pieces = [], steps(self.length, sections, min, -1.0)
        has_power = any(row.value == 1.0 for row in pieces)
        for begin, end, power, _ in pieces:
            beside = power < 0.0 and has_power and end - begin > ROUNDING
            if beside:
                print_assumption(
                    f"{self.network.place}: no {what} from {number_text(begin)} to {number_text(end)} m of the path; "
                    "assumed to have no traction power"
                )
            if beside or power == 0.0:
                found.append((begin, end))
        return found

    def stations(self) -> list[tuple[float, str]]:
        """Return the named places on the path by rising distance [m]; one name per place.

        Several tracks of a station one after the other are one place; a station that the path passes again is a further
        one.
        """
        found: dict[float, str] = {}
        for name, spots in self.network.named.items():
            places = sorted({(at, spot) for spot in spots for at in self._spots(*spot)})
            kept: list[tuple[float, tuple[str, float]]] = []
            for at, spot in places:
                again = any(spot == other for _, other in kept)
                if again or not kept or at > kept[-1][0] + SAME_STATION:
                    kept.append((at, spot))
                    found.setdefault(at, name)
        return sorted(found.items())


def network_line(
    path: TrackPath,
    kind: str,
    selection: str,
    *,
    against: bool,
    grades: Sequence[Range],
    radii: Sequence[Range],
    speeds: Sequence[Range],
    sections: dict[str, list[dict[str, Any]]],
    by_category: Mapping[str, Sequence[Range]] = MappingProxyType({}),
    needs: Mapping[str, Mapping[str, float]] = MappingProxyType({}),
) -> Line:
    """Return the line along a path, with the name of its file and selection.

    Parameters
    ----------
    kind
        Kind of the file, for the source.
    selection, against
        Selection of the path, and True for a path against it.
    grades, radii, speeds
        Grades in running direction, curve radii [m] (> 0 to the right), permanent speed limits [m/s].
    sections
        Other sections by the key of the line.
    by_category, needs
        Speed limits by train category [m/s], and the figures that a train of it needs, by the key of the line.
    """
    file = Path(path.network.place)
    _refuse_overlaps(grades, "grades")
    bends = [row if 0 < abs(row.value) < STRAIGHT else row._replace(value=0.0) for row in radii]
    _refuse_overlaps(bends, "radii")
    for row in bends:
        if 0 < abs(row.value) < SHARPEST:
            raise ValueError(f"{row.entry}: radius = {number_text(row.value)}: below {SHARPEST:g} m; correct its unit")
    curves = steps(path.length, bends, lambda values: values[-1], 0.0)
    data: dict[str, Any] = {
        "schema": "train_ato/line/1",
        "name": f"{file.stem} {selection}".rstrip() + (ENDING if against else ""),
        "source": f"{kind} {file.name}",
        "end": path.length,
        "grades": [
            {"at": row.begin, "grade": row.value} for row in steps(path.length, grades, lambda values: values[-1], 0.0)
        ],
        "curves": [
            {"begin": row.begin, "end": row.end, "radius": abs(row.value), "side": "right" if row.value > 0 else "left"}
            for row in curves
            if row.value
        ],
        "speed_limits": _without_gaps(speeds, path, ""),
        "category_limits": [
            {
                "category": category,
                "needs": dict(needs[category]) if category in needs else None,
                "speed_limits": _without_gaps(ranges, path, f" of '{category}'"),
            }
            for category, ranges in by_category.items()
            if steps(path.length, ranges, min, 0.0)
        ],
        "stops": [{"at": at, "name": station} for at, station in path.stations()],
    }
    return build_model(Line, data | sections, path.network.place)


def steps(
    length: float, ranges: Iterable[Range], choose: Callable[[list[float]], float], default: float
) -> list[Range]:
    """Return the stretches of one value from 0 to ``length``; ``choose`` takes one of overlapping values.

    A stretch without a range has the default. There are none where all have it.
    """
    listed = [entry for entry in ranges if entry[1] > entry[0]]
    places = sorted({0.0, length, *(min(max(place, 0.0), length) for entry in listed for place in entry[:2])})
    found: list[Range] = []
    for begin, end in pairwise(places):
        middle = 0.5 * (begin + end)
        values = [value for first, last, value, _ in listed if first <= middle < last]
        value = choose(values) if values else default
        if found and found[-1].value == value:
            found[-1] = found[-1]._replace(end=end)
        else:
            found.append(Range(begin, end, value))
    return found if any(row.value != default for row in found) else []


def _refuse_overlaps(ranges: Sequence[Range], what: str) -> None:
    """Refuse two values at one place, of which neither is known to be right."""
    last = Range(0.0, 0.0, 0.0)
    for row in sorted(ranges):
        end = min(row.end, last.end)
        if end > row.begin + ROUNDING and row.value != last.value:
            raise ValueError(
                f"{row.entry}: two {what} from {number_text(row.begin)} to {number_text(end)} m of the path, "
                f"{number_text(last.value)} and {number_text(row.value)} there (the other: "
                f"{last.entry.rpartition(': ')[2]}); correct one of them"
            )
        last = max(last, row, key=lambda entry: entry.end)


def _without_gaps(speeds: Iterable[Range], path: TrackPath, whose: str) -> list[dict[str, float]]:
    """Return the speed limits, of a category perhaps, with the lowest one of the path where it has none."""
    limits = steps(path.length, speeds, min, 0.0)
    if not limits:
        print_assumption(f"{path.network.place}: no speed limit on the path; only the train limits the speed")
        return []
    lowest = min(row.value for row in limits if row.value)
    found: list[dict[str, float]] = []
    for begin, end, speed, _ in limits:
        if not speed:
            print_assumption(
                f"{path.network.place}: no speed limit{whose} from {number_text(begin)} to {number_text(end)} m of the "
                f"path; assumed {number_text(3.6 * lowest)} km/h there, its lowest one"
            )
        if not found or found[-1]["speed"] != (speed or lowest):
            found.append({"at": begin, "speed": speed or lowest})
    return found
