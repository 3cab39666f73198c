"""Trains and running paths in the railtoolkit schema (rolling-stock 2022.05, running-path 2022.05 and 2024.07).

Rules of the schema's running-time calculation (Bruenger and Dahlhaus in Hansen and Pachl, "Railway Timetabling and
Operations", 2014, chapter 4; Wende, "Fahrdynamik des Schienenverkehrs", 2003, pages 151-153):

* masses in t, every vehicle with its full load; g = 9.80665 m/s²;
* Resistances are in per mille of the weight. The air term is ``air ((V + wind)/100 km/h)²``. The head wind is 15 km/h
  on locomotives, multiple units and passenger coaches, and 0 on freight wagons. Passenger coaches have a rolling term
  ``rolling V/100 km/h``. For a locomotive or multiple unit, ``base`` belongs to the driven axles and ``rolling`` to the
  other axles, both without load;
* rotating masses are weighted by the masses of the vehicles without load;
* braking at ``a_braking``, by default at -0.225 m/s² (freight) or -0.375 m/s² (passenger), on any grade.
"""

from itertools import groupby, pairwise
from pathlib import Path
from typing import Any

from plant_sim.consist import Consist
from plant_sim.elementary import plain_sum
from plant_sim.formats.fields import Fields, finite_number, known_text, names_in, print_assumption
from plant_sim.formats.ttobench import BRAKED_GRADE, rigid_train
from plant_sim.input_error import build_model
from plant_sim.line import Line, order_fault
from plant_sim.units import number_text

TRAIN_SCHEMA = "rolling-stock"
PATH_SCHEMA = "running-path"
GRAVITY = 9.80665
"""Gravity of the schema [m/s²]."""
WIND = 15.0
"""Head wind [km/h]."""
ROTATING = {"traction unit": 1.09, "multiple unit": 1.08, "passenger": 1.06, "freight": 1.06}
ADHESION = 0.33
"""Default traction over the weight on driven axles."""
TYPES = ("traction unit", "multiple unit", "passenger", "freight")
CARRIED_TRAIN = names_in("""
    schema, trains[].{formation, name}, vehicles[].{a_braking, air_resistance, base_resistance, id, length,
    load_limit, mass, mass_traction, rolling_resistance, rotation_mass, speed_limit, tractive_effort,
    vehicle_type}
""")
"""Keys of a rolling-stock file that the consist carries."""
CARRIED_PATH = names_in("""
    {path, paths[]}.{characteristic_sections, name, characteristic_sections[].{position, resistance, speed}},
    schema
""")
"""Keys of a running path that the line carries; the identifier is the name of a path without one."""


def is_railtoolkit(data: dict[str, Any], what: str) -> bool:
    """Return True if the data of a file are a ``train`` or a ``line`` of this schema."""
    schema = str(data.get("schema") or "")
    if schema:
        return (TRAIN_SCHEMA if what == "train" else PATH_SCHEMA) in schema
    if what == "train":
        return "vehicles" in data and "trains" in data
    return "paths" in data or isinstance(data.get("path"), dict)


def train_from(data: dict[str, Any], place: str, selection: str = "") -> Consist:
    """Return the train of a name or identifier in the data of a rolling-stock file, or its only one."""
    top = Fields(data, place)
    known = top.named("vehicles", "id", "vehicles")
    if "trains" not in top:
        raise ValueError(f"{place}: it has vehicles and no train; add trains: [{{name: ..., formation: [...]}}]")
    train = _selected(top, "trains", selection)
    formation = [str(name) for name in train.entries("formation")]
    for name in formation:
        if name not in known:
            raise ValueError(
                f"{train.place}: formation: '{name}' is not in vehicles ({', '.join(sorted(known))}); correct it"
            )
    used = {name: _Vehicle(known[name]) for name in dict.fromkeys(formation)}
    for kind in used.values():
        kind.note_keys_without_effect()
    return _assembled(train, place, formation, used)


class _Vehicle:
    """Vehicle of the file in SI."""

    def __init__(self, fields: Fields) -> None:
        self.fields = fields
        self.type = known_text(fields.text("vehicle_type"), f"{fields.place}: vehicle_type", TYPES)
        self.powered = self.type in ("traction unit", "multiple unit")
        self.length = fields.number("length", None, 0.1, 1e4)
        self.own = fields.number("mass", None, 1e-3, 1e5) * 1e3
        self.load = fields.number("load_limit", 0.0, 0, 1e5) * 1e3
        self.mass = self.own + self.load
        self.rotating = fields.number("rotation_mass", ROTATING[self.type], 1.0, 2.0)
        self.speed = fields.number("speed_limit", 504.0, 0.1, 720.0) / 3.6
        self.driven = fields.number("mass_traction", self.own / 1e3, 0, self.own / 1e3) * 1e3
        self.deceleration = abs(fields.number("a_braking", 0.0, -5, 5))

    def note_keys_without_effect(self) -> None:
        """Name the keys that the rules of this schema do not use for the type of the vehicle."""
        unused = () if self.powered else ("a_braking", "mass_traction", "tractive_effort")
        for key in (*unused, *(("rolling_resistance",) if self.type == "freight" else ())):
            if self.fields.data.get(key):
                print_assumption(f"{self.fields.place}: {key}: no effect in a vehicle of type '{self.type}'")

    def resistance(self) -> tuple[float, float, float]:
        """Return c0, c1, c2 of the resistance c0 + c1 v + c2 v² [N], v in m/s."""
        base = self.fields.number("base_resistance", 0.0, 0, 1e3)
        rolling = self.fields.number("rolling_resistance", 0.0, 0, 1e3)
        air = self.fields.number("air_resistance", 0.0, 0, 1e3)
        weight = self.mass * GRAVITY / 1e3
        wind = 0.0 if self.type == "freight" else WIND / 100
        per_speed = 3.6 / 100
        if self.powered:
            constant = (base * self.driven + rolling * (self.own - self.driven)) * GRAVITY / 1e3
            linear, air_weight = 0.0, self.own * GRAVITY / 1e3
        else:
            constant, air_weight = base * weight, weight
            linear = rolling * weight if self.type == "passenger" else 0.0
        return (
            constant + air * air_weight * wind**2,
            (linear + 2 * air * air_weight * wind) * per_speed,
            air * air_weight * per_speed**2,
        )

    def traction(self) -> list[dict[str, float]]:
        """Return the tractive effort as segments, linear between the points of the file."""
        if "tractive_effort" not in self.fields:
            return [{"to": self.speed, "force": ADHESION * self.driven * GRAVITY}]
        place = f"{self.fields.place}: tractive_effort"
        points = [(v / 3.6, f) for v, f in self.fields.table("tractive_effort", (0, 1e3), (0, 1e9))]
        segments: list[dict[str, float]] = []
        if len(points) == 1 or points[0][0] > 0:
            segments.append({"to": points[0][0] or self.speed, "force": points[0][1]})
        for k, ((v0, f0), (v1, f1)) in enumerate(pairwise(points)):
            if v1 <= v0:
                raise ValueError(f"{place}[{k + 1}] = [{3.6 * v1:g}, {number_text(f1)}]: speeds must rise")
            slope = (f1 - f0) / (v1 - v0)
            segments.append({"to": v1, "force": f0 - slope * v0, "slope_kn_per_kmh": slope / 3600})
        return segments


def _assembled(train: Fields, file: str, formation: list[str], used: dict[str, _Vehicle]) -> Consist:
    vehicles = [used[entry] for entry in formation]
    if not any(vehicle.powered for vehicle in vehicles):
        raise ValueError(f"{train.place}: formation has no traction unit or multiple unit; add one")
    mass = plain_sum(vehicle.mass for vehicle in vehicles)
    own = plain_sum(vehicle.own for vehicle in vehicles)
    rotating = plain_sum(vehicle.own * vehicle.rotating for vehicle in vehicles) / own
    passenger = any(vehicle.type in ("passenger", "multiple unit") for vehicle in vehicles)
    given = [vehicle.deceleration for vehicle in vehicles if vehicle.powered and vehicle.deceleration > 0]
    deceleration = min(given) if given else (0.375 if passenger else 0.225)
    speed = min(vehicle.speed for vehicle in vehicles)
    powered = sum(vehicle.powered for vehicle in vehicles)
    brake = mass * (rotating * deceleration + BRAKED_GRADE * GRAVITY) / powered
    types = {}
    for key, vehicle in used.items():
        types[key] = {
            "mass": vehicle.mass,
            "length": vehicle.length,
            "rotating_mass_factor": rotating,
            "resistance": {"n": vehicle.resistance()},
        }
        if vehicle.powered:
            types[key] |= {"traction": vehicle.traction(), "brake": [{"to": 1.05 * speed, "force": brake}]}
    parts = [{"type": name, "count": len(list(group))} for name, group in groupby(formation)]
    source, limits = f"railtoolkit rolling stock, {Path(file).name}", {"speed": speed, "deceleration": deceleration}
    name = train.text("name")
    return rigid_train(file, name, source, gravity=GRAVITY, vehicle_types=types, train=parts, plan_limits=limits)


def railtoolkit_line(data: dict[str, Any], place: str, selection: str = "") -> Line:
    """Return the running path of a name or identifier in the data of a file, or its only one.

    The resistance of a section becomes its grade. Points of interest do not become stops.
    """
    top = Fields(data, place)
    path = _selected(top, "paths", selection)
    rows = _characteristic_sections(path)
    return build_model(
        Line,
        {
            "schema": "train_ato/line/1",
            "name": path.text("name", path.text("id", "path")),
            "source": f"railtoolkit running path, {Path(place).name}",
            "begin": rows[0][0],
            "end": rows[-1][0],
            "grades": [{"at": at, "grade": grade / 1e3} for at, _, grade in rows[:-1]],
            "speed_limits": [{"at": at, "speed": speed / 3.6} for at, speed, _ in rows[:-1]],
        },
        place,
    )


def _selected(top: Fields, key: str, selection: str) -> Fields:
    """Return the train or path of a name or identifier, or the only one of a file."""
    entries = [top.below("path")] if key == "paths" and "path" in top else []
    if not entries or key in top:
        entries += top.each(key, 1)
    found = [entry for entry in entries if selection in (entry.text("id", ""), entry.text("name", "")) or not selection]
    if len(found) == 1:
        return found[0]
    names = [entry.text("id", entry.text("name", "")) for entry in entries]
    chosen = f" with '{selection[:60]}'" if selection else ""
    apart = all(names) and len({*names}) == len(names)
    remedy = f"name one as FILE:NAME, for example '{top.place}:{names[0]}'" if apart else "give each an id of its own"
    raise ValueError(
        f"{top.place}: {key}: holds {len(found) or 'none'}{chosen} (has {', '.join(names)[:200]}); {remedy}"
    )


def _characteristic_sections(path: Fields) -> list[tuple[float, float, float]]:
    """Return place [m] in running direction, speed [km/h] and grade [per mille] of the sections; the last is the end.

    A section is a list of three numbers (2022.05), or has names (2024.07) and may have only one of speed and
    resistance: the other one is that of the section before. In falling kilometres the place is the distance from the
    first section.
    """
    key = f"{path.place}: characteristic_sections"
    entries = path.entries("characteristic_sections", 2)
    last = len(entries) - 1
    rows = _completed([_section(entry, f"{key}[{k}]", at_end=k == last) for k, entry in enumerate(entries)], key)
    first = rows[0][0]
    if all(after[0] < before[0] for before, after in pairwise(rows)):
        print_assumption(f"{key}: falling kilometres: places are distances from {number_text(first)} m")
        return [(first - at, speed, grade) for at, speed, grade in rows]
    for k, (before, after) in enumerate(pairwise(rows)):
        if after[0] == before[0]:
            raise ValueError(f"{key}: two sections begin at {number_text(before[0])} m (number {k + 1}); keep one")
    if fault := order_fault([at for at, _, _ in rows]):
        raise ValueError(f"{key}{fault}")
    return rows


def _section(entry: Any, place: str, *, at_end: bool) -> tuple[float, float | None, float | None]:
    """Return place [m], speed [km/h] and grade [per mille] of a section; None for a missing one."""
    if isinstance(entry, list) and len(entry) == 3:
        entry = dict(zip(("position", "speed", "resistance"), entry, strict=True))
        names = ("[0]", "[1]", "[2]")
    elif isinstance(entry, dict):
        names = (": position", ": speed", ": resistance")
    else:
        raise ValueError(f"{place} = {str(entry)[:60]!r}: must be a list of 3, or position, speed, resistance")
    section = Fields(entry, place)
    if "speed" not in section and "resistance" not in section and not at_end:
        raise ValueError(f"{place}: it has neither speed nor resistance; add one of them")
    at = finite_number(section.required("position"), place + names[0], -1e8, 1e8)
    speed = finite_number(entry["speed"], place + names[1], 1e-3, 1e3) if "speed" in section else None
    grade = finite_number(entry["resistance"], place + names[2], -500, 500) if "resistance" in section else None
    return at, speed, grade


def _completed(rows: list[tuple[float, float | None, float | None]], key: str) -> list[tuple[float, float, float]]:
    """Return the sections with the values of the section before where they have none."""
    speeds = [speed for _, speed, _ in rows[:-1] if speed is not None]
    if not speeds or rows[0][2] is None:
        lacking = "speed" if not speeds else "resistance"
        raise ValueError(f"{key}: no {lacking} {'at all' if not speeds else 'in the first section'}; add {lacking}")
    if rows[0][1] is None:
        print_assumption(f"{key}: no speed in the first section; assumed {min(speeds):g} km/h, the lowest one")
    if any(None in row for row in rows[1:-1]):
        print_assumption(f"{key}: a section without speed or resistance has that of the section before")
    found: list[tuple[float, float, float]] = []
    speed, grade = min(speeds), 0.0
    for at, given, resistance in rows:
        speed, grade = speed if given is None else given, grade if resistance is None else resistance
        found.append((at, speed, grade))
    return found
