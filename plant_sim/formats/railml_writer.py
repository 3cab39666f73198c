"""Lines and trains written in railML 3.2; element names are those of the readers.

A line is one net element. A train is a formation, and its service brake is the deceleration of the formation.
"""

import math
import re
from collections.abc import Iterator, Sequence
from typing import Any
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import numpy as np

from plant_sim.consist import Consist, PlanLimits
from plant_sim.elementary import plain_sum
from plant_sim.formats.network_path import SAME_STATION, STRAIGHT
from plant_sim.formats.osrd_stock import lost_of_train, service_deceleration, traction_points
from plant_sim.formats.railml import CARRIED, NEEDS, STATION
from plant_sim.formats.railml2 import DAVIS
from plant_sim.formats.railml_location import BEGINS, ENDS, POSITIONS
from plant_sim.formats.railml_stock import AIR_DENSITY, MODE, MODES, TABLE, brake_share
from plant_sim.formats.writing import NOT_XML, lost_keys, refuse_overlap
from plant_sim.gears import RigidGear
from plant_sim.line import Line, Rating
from plant_sim.units import GRAVITY, KMH, number_text

OWNER = {
    tag: name.removeprefix("infrastructure.").partition(f"{tag}.")[0] + tag
    for name in reversed(CARRIED)
    for tag in name.split(".")
    if tag[0] != "@"
}
"""Names from the infrastructure to an element that the reader carries."""
IN_RAILML = (
    "grades", "curves", "tunnels", "speed_limits", "category_limits", "temporary_restrictions", "neutral_sections",
    "stops", "stops[].name",
)  # fmt: skip
NET = "line"


def _add(parent: Element, names: str, **keys: str | float) -> Element:
    """Return a new element at a path of names; the elements above it exist once."""
    *above, tag = names.split(".")
    for name in above:
        found = parent.find(name)
        parent = SubElement(parent, name) if found is None else found
    texts = {key: NOT_XML.sub("", value) if isinstance(value, str) else repr(value) for key, value in keys.items()}
    return SubElement(parent, tag, texts)


def _document(root: Element) -> str:
    indent(root)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{tostring(root, encoding="unicode")}\n'


def _root() -> Element:
    return Element("railML", xmlns="https://www.railml.org/schemas/3.2", version="3.2")


def line_railml(line: Line) -> tuple[str, tuple[str, ...]]:
    """Return a line as railML, its begin at 0, and the keys that it does not carry.

    Overlapping curves are refused, because railML has one at a place.
    """
    refuse_overlap(line, "railML")
    root, length = _root(), line.end - line.begin
    steps = {"": line.speed_limits, **{row.category: row.speed_limits for row in line.category_limits}}
    profiles = {row.category: f"profile_{number}" for number, row in enumerate(line.category_limits)}
    for row in line.category_limits:
        profile = _add(root, "common.speedProfiles.speedProfile", id=profiles[row.category])
        _add(profile, "name", name=row.category, language="en")
        needs = row.needs.model_dump(exclude_none=True) if row.needs else {}
        for tag, key, name in NEEDS:
            if (value := needs.get(name.removesuffix("_t"))) is not None:
                _add(profile, tag, **{key: _text(value / 1e3) if name.endswith("_t") else value})
    whole = _add(root, "infrastructure", id="infrastructure")
    _add(whole, OWNER["netElement"], id=NET, length=length)

    def located(tag: str, begin: float, end: float, **keys: str | float) -> Element:
        low, high = (min(max(place - line.begin, 0.0), length) for place in (begin, end))
        if high <= low:
            return _root()  # beyond the line
        entry = _add(whole, OWNER[tag], **keys)
        _add(entry, "linearLocation.associatedNetElement", netElementRef=NET, **{BEGINS[0]: low, ENDS[0]: high})
        return entry

    for at, end, entry in _pieces(line.grades, line.end):
        located("gradientCurve", at, end, gradient=_text(1e3 * entry.grade), curveType="straight")
    for bend in line.curves:
        located("horizontalCurve", bend.begin, bend.end, radius=-bend.radius if bend.side == "left" else bend.radius)
    for category, limits in steps.items():
        for at, end, entry in _pieces(limits, line.end):
            section = located("speedSection", at, end, maxSpeed=_text(KMH * entry.speed), isTemporary="false")
            if category:
                _add(section, "validForSpeedProfile", ref=profiles[category])
    for work in line.temporary_restrictions:
        located("speedSection", work.begin, work.end, maxSpeed=_text(KMH * work.speed), isTemporary="true")
    for number, stop in enumerate(line.stops):
        if line.begin <= stop.at <= line.end:
            point = _add(whole, OWNER[STATION], id=f"stop_{number}")
            _add(point, "name", name=stop.name or f"stop at {number_text(stop.at)} m", language="en")
            _add(point, "spotLocation", netElementRef=NET, **{POSITIONS[0]: stop.at - line.begin})
    for tunnel in line.tunnels:
        crossing = located("overCrossing", tunnel.begin, tunnel.end, constructionType="tunnel")
        if tunnel.cross_section is not None:
            _add(crossing, "tunnelResistance", crossSection=tunnel.cross_section)
    reached = line.begin
    for dead in sorted(line.neutral_sections, key=lambda dead: dead.begin):
        located("electrificationSection", reached, dead.begin, isInsulatedSection="false")
        located("electrificationSection", dead.begin, dead.end, isInsulatedSection="true")
        reached = max(reached, dead.end)
    if line.neutral_sections:
        located("electrificationSection", reached, line.end, isInsulatedSection="false")
    return _document(root), (*lost_keys(line, IN_RAILML), *_lost_details(line))


def _pieces(steps: Sequence[Any], end: float) -> Iterator[tuple[float, float, Any]]:
    """Yield begin and end [m] of every entry of steps, and the entry."""
    places = [*(entry.at for entry in steps), end]
    return zip(places, places[1:], steps, strict=False)


def _text(value: float) -> str:
    """Return a converted number without the rounding of its conversion."""
    return f"{value:.15g}"


def _lost_details(line: Line) -> Iterator[str]:
    """Yield what a reader of the written file would not have."""
    first = line.speed_limits[0].at if line.speed_limits else line.end
    if (line.speed_limits and first > line.begin) or (line.category_limits and not line.speed_limits):
        yield f"speed_limits: none to {number_text(first)} m (a reader takes the lowest one there)"
    for row in line.category_limits:
        if row.needs and row.needs.cant_deficiency is not None:
            yield "category_limits[].needs.cant_deficiency"
        if row.speed_limits[0].at > line.begin:
            yield f"category_limits '{row.category}': none to {number_text(row.speed_limits[0].at)} m"
    if any(bend.radius >= STRAIGHT for bend in line.curves):
        yield f"curves: of a radius above {STRAIGHT:g} m"
    stops: dict[str, float] = {}
    for stop in line.stops:
        if stop.name and stop.at - stops.get(stop.name, -math.inf) <= SAME_STATION:
            yield f"stops: '{stop.name}' at {number_text(stop.at)} m (the same station)"
        stops[stop.name] = stop.at
    for key in ("grades", "curves", "tunnels", "speed_limits", "stops", "temporary_restrictions", "neutral_sections"):
        places = [(entry.begin, entry.end) if hasattr(entry, "begin") else (entry.at, entry.at)
                  for entry in getattr(line, key)]  # fmt: skip
        if any(at < line.begin or end > line.end for at, end in places):
            yield f"{key}: beyond the line"


def train_railml(consist: Consist) -> tuple[str, tuple[str, ...]]:
    """Return a train as a formation of railML, and the keys that it does not carry.

    A train without traction or service deceleration is refused.
    """
    deceleration, limits = service_deceleration(consist, "railML"), consist.plan_limits or PlanLimits()
    powered = [vehicle for vehicle in consist.vehicles if vehicle.traction]
    if not powered:
        raise ValueError(f"train '{consist.name}': no vehicle has traction; railML needs a powered train")
    root, names = _root(), [part.type for part in consist.train for _ in range(part.count)]
    stock, rating, ids = _add(root, "rollingstock"), consist.rating or Rating(), _identifiers([consist.name, *names])
    lost = _vehicles(stock, consist, ids)
    speed = limits.speed or max(segment.to for vehicle in powered for segment in vehicle.traction)
    formation = _add(stock, "formations.formation", id=ids.pop(""), speed=_text(KMH * speed))
    for number, name in enumerate(names):
        _add(formation, "trainOrder", orderNumber=str(number), vehicleRef=ids[name])
    if limits.acceleration is not None:
        _add(formation, "trainEngine", maxAcceleration=limits.acceleration)
    percentage = {"regularBrakePercentage": rating.brake_percentage} if rating.brake_percentage else {}
    _add(formation, "trainBrakes", meanDeceleration=deceleration, **percentage)
    if stock.find(".//drivingResistance") is None:
        drags = [kind.resistance.polynomial(kind.mass, consist.gravity) for kind in consist.vehicles]
        sums = {key: _text(plain_sum(drag[k] for drag in drags) / KMH**k) for k, key in enumerate(DAVIS)}
        _add(formation, "trainResistance.daviesFormulaFactors", massDependent="false", **sums)
    lost += ["rating.cant_deficiency"] if rating.cant_deficiency else []
    rigid = all(isinstance(gear, RigidGear) for gear in consist.draft_gears.values())
    carried = ("rating", "default_gear", *(("draft_gears",) if rigid else ()))
    return _document(root), (*lost_of_train(consist, *carried), *lost)


def _identifiers(names: Sequence[str]) -> dict[str, str]:
    """Return an identifier for every name, by the name; "" for the first one."""
    found: dict[str, str] = {}
    for number, name in enumerate(["", *names[1:]]):
        plain = re.sub("[^A-Za-z0-9_.-]", "_", name or names[0])
        plain = plain if plain[:1].isalpha() else f"_{plain}"
        if name not in found:
            found[name] = plain if plain not in found.values() else f"{plain}_{number}"
    return found


def _vehicles(stock: Element, consist: Consist, ids: dict[str, str]) -> list[str]:
    """Write the vehicle types, and return the keys of them that are not carried."""
    kinds = {part.type: consist.vehicle_types[part.type] for part in consist.train}
    drags = {name: kind.resistance.polynomial(kind.mass, consist.gravity) for name, kind in kinds.items()}
    own = all(constant and not linear for constant, linear, _ in drags.values())
    heaviest = max(kinds, key=lambda name: kinds[name].mass)
    for name, kind in kinds.items():
        vehicle = _add(stock, "vehicles.vehicle", id=ids[name], bruttoWeight=_text(kind.mass / 1e3), length=kind.length)
        vehicle.set("rotatingMassFactor", repr(kind.rotating_mass_factor))
        if consist.rating and consist.rating.axle_load and name == heaviest:
            vehicle.set("maximumAxleLoad", _text(consist.rating.axle_load / 1e3))
        if kind.traction:
            mode = next(key for key, independent in MODES.items() if independent == kind.independent_power)
            table = _add(_add(vehicle, MODE, mode=mode, isPrimaryMode="true"), TABLE, xValueUnit="m/s", yValueUnit="N")
            for speed, force in zip(*traction_points([kind]), strict=True):
                _add(_add(table, "valueLine", xValue=speed), "value", yValue=_text(force))
        if own:
            area, rolling = drags[name][2] / (0.5 * AIR_DENSITY), drags[name][0] / (kind.mass * GRAVITY / 1e3)
            keys = {"crossSectionArea": _text(area), "rollingResistance": _text(rolling)}
            _add(vehicle, "drivingResistance.info", airDragCoefficient="1", **keys)
    units = len([vehicle for vehicle in consist.vehicles if vehicle.traction])
    inertia = plain_sum(vehicle.inertia for vehicle in consist.vehicles)
    force = brake_share(service_deceleration(consist, "railML"), inertia, consist.mass, units)
    brakes = {
        name: [segment.row[1] if not any(segment.row[2:]) else 0.0 for segment in kind.brake]
        for name, kind in kinds.items()
    }
    shares = [tuple(value / kinds[name].mass for value in drag) for name, drag in drags.items()]
    shared = own or np.allclose(shares, shares[0], rtol=1e-9, atol=0.0)
    return [
        *(f"vehicle_types.{name}.supply_curves" for name, kind in kinds.items() if kind.supply_curves),
        *(f"vehicle_types.{name}.brake (now meanDeceleration)" for name, brake in brakes.items()
          if bool(brake) != bool(kinds[name].traction) or not np.allclose(brake, force, rtol=1e-9)),
        *(() if shared else ("vehicle_types: resistance (now shared by mass)",)),
    ]  # fmt: skip
