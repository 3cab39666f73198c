"""Line for a train that runs against its direction: every place mirrored between begin and end."""

from __future__ import annotations

from typing import Any

from plant_sim.line import Line
from plant_sim.number_text import number_text

AGAINST = "reverse"
"""Selection of a line name for the other direction: ``LINE:reverse``."""
ENDING = f":{AGAINST}"
OTHER_SIDE = {"left": "right", "right": "left", None: None}


def reversed_line(line: Line) -> Line:
    """Return the line for the other direction of running: place x becomes begin + end - x.

    Grades change their sign, curves their side. A grade, and a speed limit, that holds from its place on in one
    direction holds up to that place in the other one.

    Raises
    ------
    ValueError
        If the line has speed limits, but none at its begin, which is the end of the reversed line.
    """

    def mirrored(place: float) -> float:
        return line.begin + line.end - place

    def stretch(entry: Any) -> dict[str, float]:
        return {"begin": mirrored(entry.end), "end": mirrored(entry.begin)}

    def stretches(entries: tuple[Any, ...]) -> tuple[Any, ...]:
        return tuple(entry.model_copy(update=stretch(entry)) for entry in reversed(entries))

    def points(entries: tuple[Any, ...]) -> tuple[Any, ...]:
        return tuple(entry.model_copy(update={"at": mirrored(entry.at)}) for entry in reversed(entries))

    if line.speed_limits and line.speed_limits[0].at > line.begin:
        raise ValueError(
            f"line '{line.name}': speed_limits: none before {number_text(line.speed_limits[0].at)} m, where a train "
            f"in the other direction ends; begin them at {number_text(line.begin)} m"
        )
    curves = tuple(curve.model_copy(update={"side": OTHER_SIDE[curve.side]}) for curve in stretches(line.curves))
    limits = [(mirrored(end), entry.speed) for entry, end in _pieces(line, line.speed_limits)]
    update = {
        "name": line.name.removesuffix(ENDING) if line.name.endswith(ENDING) else line.name + ENDING,
        "grades": [{"at": at, "grade": grade} for at, grade in _mirrored_grades(line)],
        "curves": curves,
        "tunnels": stretches(line.tunnels),
        "speed_limits": [{"at": at, "speed": speed} for at, speed in reversed(limits)],
        "temporary_restrictions": stretches(line.temporary_restrictions),
        "neutral_sections": stretches(line.neutral_sections),
        "power_limits": stretches(line.power_limits),
        "adhesion": stretches(line.adhesion),
        "stops": points(line.stops),
        "coordinates": points(line.coordinates),
    }
    data = line.model_dump(by_alias=True, exclude_unset=True)
    return Line.model_validate(data | update)


def _pieces(line: Line, entries: tuple[Any, ...]) -> list[tuple[Any, float]]:
    """Return every entry that holds on the line, with the end of its piece [m]."""
    ends = [*(entry.at for entry in entries[1:]), line.end][: len(entries)]
    return [
        (entry, min(end, line.end))
        for entry, end in zip(entries, ends, strict=True)
        if end > line.begin and entry.at < line.end
    ]


def _mirrored_grades(line: Line) -> list[tuple[float, float]]:
    """Return place [m] and grade of the pieces of the reversed line; level where the line has no grade."""
    pieces = _pieces(line, line.grades) if line.grades else []
    found = [(line.begin + line.end - end, 0.0 - entry.grade) for entry, end in reversed(pieces)]
    if pieces and pieces[0][0].at > line.begin:
        found.append((line.begin + line.end - pieces[0][0].at, 0.0))
    return found
