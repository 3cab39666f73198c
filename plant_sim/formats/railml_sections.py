"""Tunnels and electrification of railML 3 on a path.

A tunnel is an over crossing of that construction type; version 3.3 has its cross section. An electrification section
is where a system of electric power is applied: a path with such sections has no traction power outside of them, in an
insulated section, and in one without a contact line.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from plant_sim.formats.network_path import Range, TrackPath, steps
from plant_sim.formats.notes import print_assumption
from plant_sim.formats.railml_location import Location
from plant_sim.formats.railml_xml import elements_below, number_of
from plant_sim.number_text import number_text

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

CROSS_SECTION_RANGE = (1.0, 1000.0)
"""Plausible cross section of a tunnel [m²]."""
MIN_GAP = 1.0
"""Length up to which a gap between two electrification sections counts as rounding [m]."""
NO_SECTION, NO_POWER, POWER = -1.0, 0.0, 1.0


def tunnels(infrastructure: Element, location: Location, path: TrackPath) -> list[dict[str, Any]]:
    """Return the tunnels on a path by rising distance; one without a cross section adds no resistance.

    Raises
    ------
    ValueError
        One line with file, element, value and remedy.
    """
    place, found = path.network.place, []
    for crossing in elements_below(infrastructure, "overCrossing"):
        if crossing.get("constructionType") != "tunnel":
            continue
        drag = next(elements_below(crossing, "tunnelResistance"), None)
        air: dict[str, float] = {"resistance_n_per_kn": 0.0}
        if drag is not None and drag.get("crossSection") is not None:
            air = {"cross_section": number_of(drag, "crossSection", place, *CROSS_SECTION_RANGE)}
        extents = sorted((begin, end) for begin, end, _ in location.ranges(crossing, path))
        name = f"{place}: tunnel {crossing.get('id', '')}"
        if extents and "cross_section" not in air:
            print_assumption(f"{name}: it has no cross section; no additional resistance in it")
        found += [{"begin": begin, "end": end, **air} for begin, end in _joined(extents)]
    return sorted(found, key=lambda entry: (entry["begin"], entry["end"]))


def neutral_sections(infrastructure: Element, location: Location, path: TrackPath) -> list[dict[str, Any]]:
    """Return the sections of a path without traction power by rising distance; none for a path without any data."""
    listed: list[Range] = []
    for section in elements_below(infrastructure, "electrificationSection"):
        insulated = section.get("isInsulatedSection") in ("true", "1")
        value = NO_POWER if insulated or section.get("contactLineType") == "none" else POWER
        listed += [Range(begin, end, value) for begin, end, _ in location.ranges(section, path, directed=True)]
    pieces = steps(path.length, listed, min, NO_SECTION)
    has_power = any(value == POWER for _, value in pieces)
    dead: list[tuple[float, float]] = []
    ends = [at for at, _ in pieces[1:]] + [path.length]
    for (begin, power), end in zip(pieces, ends, strict=False):  # no piece without a section on the path
        if power == NO_SECTION and has_power and end - begin > MIN_GAP:
            print_assumption(
                f"{path.network.place}: no electrificationSection from {number_text(begin)} to {number_text(end)} m of "
                "the path; assumed to have no traction power"
            )
            dead.append((begin, end))
        elif power == NO_POWER:
            dead.append((begin, end))
    return [{"begin": begin, "end": end} for begin, end in _joined(dead)]


def _joined(extents: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """Return sorted extents [m] with touching ones as one: a section runs over several net elements."""
    found: list[tuple[float, float]] = []
    for begin, end in extents:
        if found and begin <= found[-1][1] + MIN_GAP:
            found[-1] = (found[-1][0], max(end, found[-1][1]))
        elif end > begin:
            found.append((begin, end))
    return found
