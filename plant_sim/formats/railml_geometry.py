"""Grades and curve radii of railML 3 on a path.

A gradient curve of the type arc has a change of gradient in place of a gradient, a horizontal curve that is a
transition has no radius: gradient and curvature are linear between the values at both ends, those of the neighbours.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

from plant_sim.formats.network_path import ROUNDING, STRAIGHT, Range, TrackPath
from plant_sim.formats.notes import print_assumption
from plant_sim.formats.railml_location import Location
from plant_sim.formats.railml_xml import elements_below, entry_of, number_of
from plant_sim.number_text import number_text

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

KINDS = ("straight", "arc", "mixed")
"""Types of gradient curves."""
PIECE, PIECES = 20.0, 10
"""Length of the pieces of a transition [m], and their largest number."""
DELTA_ROUNDING = 5e-4
"""Difference between deltaGradient and the gradients of the neighbours that counts as rounding."""


class _Transition(NamedTuple):
    """Stretch [m] with a linear change of a value; the change is None if the file does not have it."""

    begin: float
    end: float
    change: float | None
    entry: str


def grades(infrastructure: Element, location: Location, path: TrackPath) -> list[Range]:
    """Return the grades on a path in running direction; an arc as pieces of constant grade.

    Raises
    ------
    ValueError
        One line with file, element, value and remedy.
    """
    place = path.network.place
    rows: list[Range] = []
    arcs: list[_Transition] = []
    for curve in elements_below(infrastructure, "gradientCurve"):
        entry = entry_of(curve, place)
        passages = location.ranges(curve, path, signed=True)
        delta = 1e-3 * number_of(curve, "deltaGradient", place) if curve.get("deltaGradient") is not None else None
        if (kind := curve.get("curveType", "straight")) not in KINDS:
            raise ValueError(f"{entry}: curveType = '{kind[:30]}': must be one of {', '.join(KINDS)}; correct it")
        if curve.get("gradient") is not None and not delta:
            value = 1e-3 * number_of(curve, "gradient", place, -500, 500)
            rows += [Range(begin, end, value if forward else -value, entry) for begin, end, forward in passages]
        elif kind == "mixed" and delta is None:
            print_assumption(f"{entry}: of the type mixed without a gradient; left out")
        else:
            arcs += [_Transition(begin, end, delta, entry) for begin, end in _joined(passages)]
    found = _between(rows, arcs, None)
    for arc in arcs:
        known = found.get(arc)
        if known is None:
            raise ValueError(
                f"{arc.entry}: its gradient is not known: it has none, and no neighbour with one; add gradient"
            )
        first, last = known
        if arc.change is not None and abs(last - first - arc.change) > DELTA_ROUNDING:
            print_assumption(
                f"{arc.entry}: deltaGradient = {number_text(1e3 * arc.change)}: its neighbours differ by "
                f"{number_text(1e3 * (last - first))} per mille; read linear between them"
            )
    return rows + [piece for arc, (first, last) in found.items() for piece in _pieces(arc, first, last)]


def radii(infrastructure: Element, location: Location, path: TrackPath) -> list[Range]:
    """Return the curve radii on a path [m], > 0 to the right in running direction.

    Raises
    ------
    ValueError
        One line with file, element, value and remedy.
    """
    place = path.network.place
    rows: list[Range] = []
    transitions: list[_Transition] = []
    for curve in elements_below(infrastructure, "horizontalCurve"):
        entry = entry_of(curve, place)
        passages = location.ranges(curve, path, signed=True)
        if curve.get("radius") is not None:
            radius = number_of(curve, "radius", place)
            bend = 1.0 / radius if radius else 0.0
            rows += [Range(begin, end, bend if forward else -bend, entry) for begin, end, forward in passages]
        elif curve.get("curveType") not in ("straight", "mixed"):
            transitions += [_Transition(begin, end, None, entry) for begin, end in _joined(passages)]
    found = _between(rows, transitions, 0.0)
    rows += [piece for entry, (first, last) in found.items() for piece in _pieces(entry, first, last)]
    return [Range(row.begin, row.end, 1.0 / row.value, row.entry) for row in rows if abs(row.value) > 1.0 / STRAIGHT]


def _joined(passages: Sequence[tuple[float, float, bool]]) -> list[tuple[float, float]]:
    """Return the stretches of one element, over several net elements as one."""
    found: list[tuple[float, float]] = []
    for begin, end, _ in sorted(passages):
        if found and begin <= found[-1][1] + ROUNDING:
            found[-1] = (found[-1][0], max(end, found[-1][1]))
        else:
            found.append((begin, end))
    return found


def _between(
    rows: Sequence[Range], transitions: Sequence[_Transition], beside: float | None
) -> dict[_Transition, tuple[float, float]]:
    """Return the values at begin and end of the transitions, from the rows and transitions that they touch.

    ``beside`` is the value where nothing touches; with None, the change of the file gives the other end.
    """
    firsts: dict[_Transition, float] = {}
    lasts: dict[_Transition, float] = {}
    for entry in transitions:
        for row in rows:
            if abs(row.end - entry.begin) <= ROUNDING:
                firsts[entry] = row.value
            if abs(row.begin - entry.end) <= ROUNDING:
                lasts[entry] = row.value
    order = sorted(transitions)
    for sequence in (order, order[::-1]) * 2:  # a chain of arcs takes its values from both sides
        for entry in sequence:
            if entry.change is not None and entry in firsts:
                lasts.setdefault(entry, firsts[entry] + entry.change)
            if entry.change is not None and entry in lasts:
                firsts.setdefault(entry, lasts[entry] - entry.change)
        for before, after in pairwise(order):
            if abs(before.end - after.begin) <= ROUNDING:
                if before in lasts:
                    firsts.setdefault(after, lasts[before])
                if after in firsts:
                    lasts.setdefault(before, firsts[after])
    if beside is not None:
        return {entry: (firsts.get(entry, beside), lasts.get(entry, beside)) for entry in order}
    return {entry: (firsts[entry], lasts[entry]) for entry in order if entry in firsts and entry in lasts}


def _pieces(entry: _Transition, first: float, last: float) -> list[Range]:
    """Return pieces with the mean value of each."""
    count = max(1, min(PIECES, math.ceil((entry.end - entry.begin) / PIECE)))
    length = (entry.end - entry.begin) / count
    return [
        Range(
            entry.begin + k * length,
            entry.begin + (k + 1) * length,
            first + (last - first) * (k + 0.5) / count,
            entry.entry,
        )
        for k in range(count)
    ]
