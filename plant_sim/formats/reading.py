"""Lines and trains from a file of any supported format, recognised by its content."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

from plant_sim.consist import Consist
from plant_sim.elementary import plain_sum
from plant_sim.formats import altrios, line_table, osrd, osrd_stock, railtoolkit, survey, ttobench
from plant_sim.formats.fields import keyed, keys_not_carried, print_assumption, read_any, refuse_foreign
from plant_sim.formats.network_path import ROUNDING
from plant_sim.formats.railml import holds_stock, is_railml, railml_line
from plant_sim.formats.railml_collection import read_xml
from plant_sim.formats.railml_stock import railml_train
from plant_sim.input_error import build_model
from plant_sim.line import Line, LineSection, reversed_line
from plant_sim.si_model import unusual_values
from plant_sim.units import number_text

FAST = 100.0
"""Speed above which a limit is probably in km/h [m/s]."""
ROUND, QUICK = 5.0, 40.0
"""Speed of which a limit in km/h in place of m/s is often a multiple, and above which it is seldom one [m/s]."""
SIDEWAYS = 3.0
"""Lateral acceleration of a curve, cant included, above which its radius or its speed is in another unit [m/s²]."""
FLAT, STEEP = 1e-4, 0.1
"""Grade above which it is probably in another unit, and below which that of the steepest stretch is."""
LIGHT, HEAVY = 100.0, 15e3
"""Mass per length outside of which mass or length are probably in another unit [kg/m]."""
WEAK, STRONG = 1e-3, 1.0
"""Traction over weight outside of which it is probably in another unit."""
POWERFUL, CLIFF = 300.0, 50.0
"""Power over mass above which it is probably in another unit [W/kg], and ratio of two neighbouring segments."""
EASY, STIFF = 1e-4, 0.5
"""Running resistance at 20 m/s over weight outside of which it is probably in another unit."""
SLUGGISH = 2.0
"""Rotating mass factor above which it is probably a percentage."""
SHORT, LONG = 100.0, 5e6
"""Lengths of a line [m] below and above which its places are probably in another unit."""


@dataclass(frozen=True, slots=True)
class ReadLine:
    """Line of a file, its format, and the keys of the file that the line does not carry."""

    line: Line
    format: str
    left_out: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class ReadConsist:
    """Train of a file, its format, and the keys of the file that the consist does not carry."""

    consist: Consist
    format: str
    left_out: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class _Format:
    """Format of data: its name, ``line`` or ``train``, recognition by content, reader, and carried keys.

    Attributes
    ----------
    takes : tuple of str
        Other arguments of the reader than data and place. ``selection`` has one of several lines or trains.
    """

    name: str
    what: str
    holds: Callable[[Any], Any]
    read: Callable[..., Any]
    carried: tuple[str, ...]
    takes: tuple[str, ...] = ("selection",)


def _own_train(data: dict[str, Any], place: str, selection: str) -> tuple[Consist, tuple[str, ...]]:
    consist = build_model(Consist, data, place)
    return osrd_stock.with_supply(consist, selection, place) if selection else consist, ()


PATH = ("selection", "against")
FORMATS = (
    _Format("ALTRIOS", "line", altrios.links_of, altrios.altrios_line, (), PATH),
    _Format("OSRD", "line", lambda data: _has(data, track_sections=list), osrd.osrd_line, osrd.CARRIED_INFRA, PATH),
    _Format("railtoolkit", "line", lambda data: railtoolkit.is_railtoolkit(data, "line"),
            railtoolkit.railtoolkit_line, railtoolkit.CARRIED_PATH),
    _Format("GeoJSON", "line", survey.is_geojson, survey.geojson_line, survey.CARRIED),
    _Format("TTOBench", "line", lambda data: _has(data, stops=dict) and "speed limits" in data,
            ttobench.ttobench_line, ttobench.CARRIED_LINE, ()),
    _Format("train_ato", "line", lambda data: _is_own(data, "line"),
            lambda data, place: (build_model(Line, data, place), ()), (), ()),
    _Format("railtoolkit", "train", lambda data: railtoolkit.is_railtoolkit(data, "train"),
            railtoolkit.train_from, railtoolkit.CARRIED_TRAIN),
    _Format("OSRD", "train", lambda data: _has(data, effort_curves=dict), osrd_stock.osrd_train, osrd_stock.CARRIED),
    _Format("train_ato", "train", lambda data: _is_own(data, "consist"), _own_train, ()),
    _Format("ALTRIOS", "train", altrios.is_altrios_train, altrios.altrios_train, altrios.CARRIED_TRAIN, ()),
    _Format("TTOBench", "train", lambda data: {"max traction force", "rolling resistance r0"} <= data.keys(),
            ttobench.ttobench_train, ttobench.CARRIED_TRAIN, ("point_mass",)),
)  # fmt: skip
"""Formats of YAML and JSON, in the order of their recognition; railML, tables and GPX have their endings."""


def _has(data: Any, **kinds: type) -> bool:
    return all(isinstance(data.get(key), kind) for key, kind in kinds.items())


def _is_own(data: Any, kind: str) -> bool:
    return str(data.get("schema", "")).startswith(f"train_ato/{kind}/")


def _recognised(data: Any, what: str = "") -> list[_Format]:
    """Return the formats of data; a list is a network of ALTRIOS or nothing."""
    return [entry for entry in FORMATS if what in ("", entry.what) and (isinstance(data, dict) or entry is FORMATS[0])
            and entry.holds(data)]  # fmt: skip


def _read(path: Path, what: str, selection: str, **given: Any) -> tuple[Any, _Format, tuple[str, ...]]:
    """Return the line or train in YAML or JSON, its format, and the keys that it does not carry."""
    data, place = read_any(path), str(path)
    found = _recognised(data, what)
    if not found:
        refuse_foreign(keyed(data, path), place, what, kinds_of(data))
    if "selection" not in found[0].takes:
        refuse_selection(selection, place, what)
    arguments = {key: value for key, value in {"selection": selection, **given}.items() if key in found[0].takes}
    read = found[0].read(data, place, **arguments)
    model, left = read if isinstance(read, tuple) else (read, keys_not_carried(data, found[0].carried))
    return model, found[0], left


def read_line(path: Path, selection: str = "", *, against: bool = False) -> ReadLine:
    """Return the line of a file; of a network the path of a selection ``FROM..TO``.

    Parameters
    ----------
    against
        True for the line of a train in the other direction; a path through a network is read anew, because limits may
        differ by direction, another line is mirrored.
    """
    place, mirrored = str(path), against
    if is_railml(path):
        found, mirrored = ReadLine(*railml_line(path, selection, against=against)), False
    elif line_table.is_line_table(path):
        refuse_selection(selection, place, "line")
        found = ReadLine(line_table.table_line(path), "table")
    elif survey.is_gpx(path):
        line, left = survey.gpx_line(read_xml(path), place, selection)
        found = ReadLine(line, "GPX", left)
    else:
        line, form, left = _read(path, "line", selection, against=against)
        found, mirrored = ReadLine(line, form.name, left), against and "against" not in form.takes
    for text in (*_traps(found), *_outside(found.line)):
        print_assumption(f"{place}: {text}")
    return replace(found, line=reversed_line(found.line)) if mirrored else found


def refuse_selection(selection: str, place: str, what: str) -> None:
    """Refuse a selection in a file with one line or train."""
    if selection:
        raise ValueError(f"{place}: selection '{selection}': the file has one {what}; remove it")


def read_train(path: Path, *, point_mass: bool = False, selection: str = "") -> ReadConsist:
    """Return the train of a file; as a point mass it needs no length.

    Parameters
    ----------
    selection
        Name or identifier of one of several trains.
    """
    if is_railml(path):
        found = ReadConsist(*railml_train(path, selection))
    elif kind := _track_kind(path):
        raise ValueError(f"{path}: holds a line ({kind}), no train; exchange them")
    else:
        consist, form, left = _read(path, "train", selection, point_mass=point_mass)
        found = ReadConsist(consist, form.name, left)
    doubts = (f"{doubt}; check its unit" for doubt in _train_traps(found.consist))
    for text in (*doubts, *_without_effect(found.consist)):
        print_assumption(f"{path}: {text}")
    return found


def _track_kind(path: Path) -> str:
    """Return the format of a file that holds a line by its ending; empty for another one."""
    return "GPX" if survey.is_gpx(path) else "table" if line_table.is_line_table(path) else ""


def holds_train(path: Path) -> bool:
    """Return True if a file has a train, False if it has a line or neither."""
    if is_railml(path):
        return holds_stock(path)
    return not _track_kind(path) and "train" in kinds_of(read_any(path))


def kinds_of(data: Any) -> dict[str, str]:
    """Return the format of data, as ``train`` or ``line``; empty for an unknown one."""
    return {entry.what: entry.name for entry in reversed(_recognised(data))}


def _train_traps(consist: Consist) -> Iterator[str]:
    """Yield masses, lengths, forces, powers and resistances that are probably in another unit."""
    weight = consist.mass * consist.gravity
    for name, kind in consist.vehicle_types.items():
        if not LIGHT * kind.length <= kind.mass <= HEAVY * kind.length:
            yield f"{name}: mass {number_text(kind.mass)} kg on {number_text(kind.length)} m"
        if kind.rotating_mass_factor > SLUGGISH:
            yield f"{name}: rotating_mass_factor {number_text(kind.rotating_mass_factor)}"
        a, b, c = kind.resistance.polynomial(kind.mass, consist.gravity)
        drag, own = a + 20.0 * b + 400.0 * c, kind.mass * consist.gravity
        if drag and not EASY * own <= drag <= STIFF * own:
            mass = number_text(kind.mass)
            yield f"{name}: running resistance {number_text(drag)} N at 72 km/h for {mass} kg"
        for key, segments in (("traction", kind.traction), ("brake", kind.brake)):
            for one, other in pairwise(segments or ()):
                last, first = one.at(one.to), other.at(one.to)
                if last > CLIFF * first > 0.0 or first > CLIFF * last > 0.0:
                    change = f"from {number_text(last)} N to {number_text(first)} N at {number_text(one.to)} m/s"
                    yield f"{name}: {key} changes {change}"
    speed = consist.plan_limits.speed if consist.plan_limits else None
    if speed and speed > FAST:
        yield f"speed {number_text(speed)} m/s is {number_text(3.6 * speed)} km/h"
    yield from unusual_values(consist)
    driven = [consist.vehicles[unit].traction for unit in consist.power_units]
    braked = [vehicle.brake for vehicle in consist.vehicles if vehicle.brake]
    for key, force in (
        ("traction", plain_sum(segments[0].at(0.1) for segments in driven)),
        ("brake", plain_sum(max(part.at(part.to) for part in segments) for segments in braked)),
    ):
        if force and not WEAK * weight <= force <= STRONG * weight:
            yield f"{key} {number_text(force)} N for {number_text(consist.mass)} kg"
    power = plain_sum(max(part.to * part.at(part.to) for part in segments) for segments in driven)
    if power > POWERFUL * consist.mass:
        yield f"traction power {number_text(power)} W for {number_text(consist.mass)} kg"


def _without_effect(consist: Consist) -> Iterator[str]:
    """Yield the data of the brakes that have no effect, each with its remedy."""
    with_shoes = [name for name, kind in consist.vehicle_types.items() if kind.shoes is not None]
    if with_shoes and consist.air_brake is None:
        yield f"{with_shoes[0]}: shoes have no effect without an air brake; add air_brake: {{}}"
    if consist.air_brake is not None and not any(vehicle.shoes for vehicle in consist.vehicles):
        yield "air_brake has no force, because no vehicle of the train has shoes; add shoes"
    for name, kind in consist.vehicle_types.items():
        for speed in sorted(part.to for part in (*kind.electric_brake, *kind.brake)):
            electric, whole = (
                next((part.at(speed) for part in envelope if speed <= part.to), 0.0)
                for envelope in (kind.electric_brake, kind.brake)
            )
            if electric > whole + 1.0:
                text = (
                    f"{number_text(electric)} N at {number_text(speed)} m/s, more than brake with {number_text(whole)}"
                )
                yield f"{name}: electric_brake has {text} N, of which it is a part; correct one of them"
                break


def _traps(found: ReadLine) -> Iterator[str]:
    """Yield speeds and grades that are probably in another unit, and entries over another one."""
    line = found.line
    if not SHORT <= (length := line.end - line.begin) <= LONG:
        yield f"the line is {number_text(length)} m long; check the unit of its places"
    yield from (f"{text}; check its unit" for text in unusual_values(line))
    speeds = [(f"speed_limits[{k}]", entry.speed) for k, entry in enumerate(line.speed_limits)]
    speeds += [(f"temporary_restrictions[{k}]", entry.speed) for k, entry in enumerate(line.temporary_restrictions)]
    speeds += [(f"category_limits '{row.category}'", e.speed) for row in line.category_limits for e in row.speed_limits]
    fast = [(key, speed) for key, speed in speeds if speed > FAST or _in_kmh(speed)]
    remedy = "write speed_kmh for km/h" if found.format == "train_ato" else "check its unit"
    for key, speed in fast[:1]:
        yield f"{key}: speed {number_text(speed)} is {number_text(3.6 * speed)} km/h{_more(fast)}; {remedy}"
    if sharp := max(_lateral(line), default=None):
        yield (
            f"curves: {number_text(sharp[0], 3)} m/s² to the side at {number_text(sharp[1])} m, with "
            f"{number_text(3.6 * sharp[2])} km/h on a radius of {number_text(sharp[3])} m; check their units"
        )
    steep = [(k, entry.grade) for k, entry in enumerate(line.grades) if abs(entry.grade) > STEEP]
    for k, grade in steep[:1]:
        per_mille = f"{number_text(1e3 * grade)} per mille{_more(steep)}"
        yield f"grades[{k}]: grade {number_text(grade)} is {per_mille}; check its unit"
    steepest = max((abs(entry.grade) for entry in line.grades), default=0.0)
    if 0.0 < steepest < FLAT:
        yield f"grades: the steepest is {number_text(1e3 * steepest)} per mille; check its unit"
    added = (("curves", line.curves), ("tunnels", [entry for entry in line.tunnels if entry.resistance_n_per_kn]))
    for key, one, other in ((key, *pair) for key, rows in added for pair in pairwise(sorted(rows, key=_begin))):
        if other.begin < one.end - ROUNDING:
            both = f"from {number_text(other.begin)} to {number_text(min(one.end, other.end))} m"
            yield f"{key}: two {both}; their resistances add"
    for key, limits in (
        ("speed_limits", line.speed_limits),
        *((f"category_limits '{row.category}'", row.speed_limits) for row in line.category_limits),
    ):
        if limits and limits[0].at > line.begin:
            gap = f"from {number_text(line.begin)} to {number_text(limits[0].at)} m"
            yield f"{key}: none {gap}; only the train limits the speed there"


def _in_kmh(speed: float) -> bool:
    """Return True for a speed [m/s] that is a round number, but has no round one in km/h."""
    return speed > QUICK and not speed % ROUND and bool(round(3.6 * speed) % 10)


def _lateral(line: Line) -> Iterator[tuple[float, float, float, float]]:
    """Yield acceleration [m/s²], place [m], limit [m/s] and radius [m] of the limits that are too fast for a curve."""
    ends = [*(limit.at for limit in line.speed_limits[1:]), line.end]
    for limit, end in zip(line.speed_limits, ends, strict=False):
        for curve in line.curves:
            sideways = limit.speed**2 / curve.radius
            if sideways > SIDEWAYS and curve.begin < end and limit.at < curve.end:
                yield sideways, max(curve.begin, limit.at), limit.speed, curve.radius


def _outside(line: Line) -> Iterator[str]:
    """Yield entries that lie outside of the line."""
    for name in ("grades", "speed_limits", "stops", "curves", "tunnels", "temporary_restrictions", "neutral_sections",
                 "power_limits", "adhesion", "vertical_curves", "coordinates"):  # fmt: skip
        rows = getattr(line, name)
        begins = [float(row.begin if hasattr(row, "begin") else row.at) for row in rows]
        ends = [float(getattr(row, "end", line.end)) for row in rows]
        late = [k for k, at in enumerate(begins) if at <= line.end < ends[k] - ROUNDING]
        early = [k for k, at in enumerate(begins) if ends[k] <= line.begin or (name == "stops" and at < line.begin)]
        beyond = [k for k, at in enumerate(begins) if at > line.end]
        for found, what, places, where, limit in (
            (late, "its end ", ends, "beyond the end", line.end),
            (early, "", begins, "before the begin", line.begin),
            (beyond, "", begins, "beyond the end", line.end),
        ):
            for k in found[:1]:
                at = f"{what}{number_text(places[k])} m"
                yield f"{name}[{k}]: {at} lies {where} of the line, {number_text(limit)} m{_more(found)}"


def _begin(section: LineSection) -> float:
    return section.begin


def _more(entries: Sequence[object]) -> str:
    """Return the number of entries behind the first one, for a message that shows the first."""
    return f" (and {len(entries) - 1} more)" if len(entries) > 1 else ""
