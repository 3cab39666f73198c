"""Lines of TTOBench, an open library of train trajectory optimisation benchmarks (JSON, BSD-2).

Stops, speed limits and gradients are over the distance; gradients are positive uphill in the direction of running.
Curvatures are linear in 1/R between their entries (transition curves); they become short curves of their mean
curvature, which gives the correct work of their resistance. A tunnel has a cross section; its resistance is a figure of
the train.

Trains of TTOBench up to layout 1.5: a point mass with forces, powers and efficiencies (JSON, BSD-2).

The train becomes one vehicle. Its brake envelope is the electric plus the pneumatic service brake, up to the service
deceleration on a fall of 50 per mille. The emergency brake is that of the ETCS data, else the weaker one of pneumatic
brake and default. Tunnel coefficients are added to the quadratic running resistance.
"""

import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from plant_sim.brake_data import EmergencyBrake
from plant_sim.consist import Consist
from plant_sim.formats.fields import Fields, finite_number, known_text, names_in, print_assumption
from plant_sim.input_error import build_model
from plant_sim.line import Line, order_fault
from plant_sim.railway import shoe_force
from plant_sim.units import GRAVITY, number_text

LENGTHS = {"m": 1.0, "km": 1e3}
SPEEDS = {"km/h": 1 / 3.6, "m/s": 1.0}
SLOPES = {"permil": 1e-3, "percent": 1e-2, "1": 1.0}
STEPS = {"velocity": (SPEEDS, 1e-3, 1e3, 1), "slope": (SLOPES, -1e3, 1e3, 0)}
"""Units, lowest and highest value, and least number of the entries of a quantity."""
STEEPEST = 0.5
STRAIGHT = 1e5
"""Radius beyond which a curve counts as straight [m]."""
TRANSITION, PIECES = 20.0, 10
"""Length of the parts of a transition curve [m], and their largest number."""
CARRIED_LINE = names_in("""
    curvatures.{unit, values, units.{position, radius at end, radius at start}}, gradients.{unit, values,
    units.{position, slope}}, metadata.id, speed limits.{unit, values, units.{position, velocity}}, stops.{unit,
    values, units.position}, tunnels.{unit, values, units.{cross section, length, position}}
""")
"""Keys of a line that the own file carries."""


def ttobench_line(data: dict[str, Any], place: str) -> Line:
    """Return the line in the data of a file."""
    top = Fields(data, place)
    stops = _stops(top.below("stops"))
    limits = _steps(top.below("speed limits"), "velocity")
    grades = _steps(top.below("gradients"), "slope") if "gradients" in top else []
    name = Path(place).stem
    if isinstance(data.get("metadata"), dict):
        name = Fields(data["metadata"], f"{place}: metadata").text("id", name)
    begin, end = min(stops[0], 0.0), stops[-1]
    if limits[0][0] > begin:
        lowest = min(speed for _, speed in limits)
        print_assumption(
            f"{place}: no speed limit from {number_text(begin)} to {number_text(limits[0][0])} m; assumed "
            f"{number_text(3.6 * lowest)} km/h there, its lowest one"
        )
        limits.insert(0, (begin, lowest))
    return build_model(
        Line,
        {
            "schema": "train_ato/line/1",
            "name": name,
            "source": f"TTOBench line {name}, BSD-2-Clause",
            "begin": begin,
            "end": end,
            "grades": [{"at": at, "grade": value} for at, value in grades],
            "curves": _curves(top, end),
            "tunnels": _tunnels(top),
            "speed_limits": [{"at": at, "speed": value} for at, value in limits],
            "stops": [{"at": at} for at in stops],
        },
        place.split(": ")[0],
    )


def _unit(fields: Fields, quantity: str, units: dict[str, float]) -> float:
    several = fields.one_of("unit", "units") == "units"
    name = fields.below("units").text(quantity) if several else fields.text("unit")
    return units[known_text(name, f"{fields.place}: unit of {quantity}", units)]


def _stops(fields: Fields) -> list[float]:
    unit = _unit(fields, "position", LENGTHS)
    stops = [at * unit for at in fields.numbers("values", -1e8, 1e8, 2)]
    if fault := order_fault(stops):
        raise ValueError(f"{fields.place}: values{fault}")
    return stops


def _steps(fields: Fields, quantity: str) -> list[tuple[float, float]]:
    """Return position and value of every entry; two values at one position are refused."""
    units, low, high, least = STEPS[quantity]
    length, unit = _unit(fields, "position", LENGTHS), _unit(fields, quantity, units)
    steps: dict[float, float] = {}
    rows = fields.table("values", (-1e8, 1e8), (low, high), least=least)
    for k, (at, value) in enumerate(rows):
        place, position, found = f"{fields.place}: values[{k}]", at * length, value * unit
        if steps and position < next(reversed(steps)):
            raise ValueError(f"{fields.place}: values{order_fault([at * length for at, _ in rows])}")
        if steps.get(position, found) != found:
            raise ValueError(f"{place}: two values at {number_text(position)} m; keep one")
        if quantity == "slope" and abs(found) > STEEPEST:
            raise ValueError(
                f"{place}[1] = {number_text(value)}: {number_text(1e3 * found)} per mille; correct its unit"
            )
        steps[position] = found
    return list(steps.items())


def _curves(top: Fields, end: float) -> list[dict[str, float]]:
    if "curvatures" not in top:
        return []
    fields = top.below("curvatures")
    unit = _unit(fields, "position", LENGTHS)
    scales = [_unit(fields, f"radius at {edge}", LENGTHS) for edge in ("start", "end")]
    rows: list[tuple[float, float, float]] = []
    for k, row in enumerate(fields.rows("values", 3, 0)):
        place = f"{fields.place}: values[{k}]"
        first, last = (_curvature(value, f"{place}[{i + 1}]") / scales[i] for i, value in enumerate(row[1:]))
        rows.append((finite_number(row[0], f"{place}[0]", -1e8, 1e8) * unit, first, last))
    if fault := order_fault([at for at, _, _ in rows]):
        raise ValueError(f"{fields.place}: values{fault}")
    ends = [at for at, _, _ in rows[1:]] + [end]
    return [
        curve
        for (at, first, last), stop in zip(rows, ends, strict=False)  # no row: none of the ends
        if stop > at
        for curve in _transition(at, stop, first, last)
    ]


def _tunnels(top: Fields) -> list[dict[str, float]]:
    """Return the tunnels with their cross section [m²]; one without length has no effect."""
    if "tunnels" not in top:
        return []
    fields = top.below("tunnels")
    position, length = (_unit(fields, quantity, LENGTHS) for quantity in ("position", "length"))
    _unit(fields, "cross section", {"m^2": 1.0})
    return [
        {"begin": at * position, "end": at * position + extent * length, "cross_section": section}
        for at, extent, section in fields.table("values", *[(0.0, 1e8)] * 3, least=0)
        if extent > 0
    ]


def _transition(begin: float, end: float, first: float, last: float) -> list[dict[str, float]]:
    """Return the curves of an entry with a linear change from the first to the last curvature [1/m]."""
    count = 1 if first == last else min(PIECES, math.ceil((end - begin) / TRANSITION))
    length = (end - begin) / count
    mean = [abs(first + (last - first) * (k + 0.5) / count) for k in range(count)]
    return [
        {"begin": begin + k * length, "end": begin + (k + 1) * length, "radius": 1 / curvature}
        for k, curvature in enumerate(mean)
        if curvature > 1 / STRAIGHT
    ]


def _curvature(value: Any, place: str) -> float:
    """Return 1/R with its sign; 0, null and 'infinity' are straight."""
    if value is None or (isinstance(value, str) and "inf" in value.lower()) or value in (float("inf"), float("-inf")):
        return 0.0
    radius = finite_number(value, place)
    return 1 / radius if radius else 0.0


KILO = 1e3
UNITS: dict[str, dict[str, float]] = {
    "length": {"m": 1.0, "km": KILO},
    "mass": {"kg": 1.0, "t": KILO},
    "speed": {"m/s": 1.0, "km/h": 1 / 3.6},
    "power": {"W": 1.0, "kW": KILO, "MW": 1e6},
    "force": {"N": 1.0, "kN": KILO},
    "acceleration": {"m/s^2": 1.0},
    "time": {"s": 1.0},
    "ratio": {"-": 1.0, "%": 1e-2},
    "count": {"-": 1.0},
    "force per speed": {"N/(m/s)": 1.0, "kN/(m/s)": KILO, "kN/(km/h)": 3.6 * KILO},
    "force per speed²": {"N/(m/s)^2": 1.0, "kN/(m/s)^2": KILO, "kN/(km/h)^2": 3.6**2 * KILO, "kg/m": 1.0},
    "area": {"m^2": 1.0},
}
"""Accepted units of every quantity, with their factor to SI."""
COACH_LENGTH = 25.0
"""Assumed length of a coach of a file without a length [m]."""
BRAKED_GRADE = 0.05
"""Largest falling grade on which the service deceleration is reached."""
OVERSPEED = 1.05
"""End of the brake envelope over the largest speed."""
CARRIED_TRAIN = names_in("""
    ETCS braking data.{A_brake_emergency.{units.{deceleration, velocity}, values}, T_be.{unit, value}},
    {efficiency reg brake, efficiency traction, length, mass, max acceleration, max deceleration,
    max pn braking force, max reg braking force, max reg braking power, max speed, max traction force,
    max traction power, rho, rolling resistance r0, rolling resistance r1, rolling resistance r2}.{unit, value},
    metadata.id, tunnel resistance.{cross section unit, unit, values, units.{coefficient, cross section},
    values[].{cross section, value}}
""")


def ttobench_train(data: dict[str, Any], place: str, *, point_mass: bool = False) -> Consist:
    """Return the train in the data of a file; a point mass needs no length."""
    top = Fields(data, place)
    mass = _quantity(top, "mass", "mass", low=1.0)
    factor = 1.0 + (_quantity(top, "rho", "ratio", high=1.0) if "rho" in top else 0.0)
    speed = _quantity(top, "max speed", "speed", low=0.1, high=200.0)
    acceleration, deceleration = (
        _quantity(top, key, "acceleration", low=1e-3, high=10.0) if key in top else None
        for key in ("max acceleration", "max deceleration")
    )
    electric = _hyperbola(top, "max reg braking", speed * OVERSPEED)
    pneumatic = _quantity(top, "max pn braking force", "force") if "max pn braking force" in top else 0.0
    bound = math.inf if deceleration is None else mass * (factor * deceleration + BRAKED_GRADE * GRAVITY)
    name = Path(place).stem
    if isinstance(data.get("metadata"), dict):
        name = Fields(data["metadata"], f"{place}: metadata").text("id", name)
    resistance = [
        _quantity(top, f"rolling resistance r{power}", kind)
        for power, kind in enumerate(("force", "force per speed", "force per speed²"))
    ]
    vehicle = {
        "mass": mass,
        "length": _length(top, point_mass=point_mass),
        "rotating_mass_factor": factor,
        "resistance": {"n": resistance},
        "traction": _hyperbola(top, "max traction", speed),
        "brake": _with_pneumatic(electric, pneumatic, bound),
        "electric_brake": electric if pneumatic > 0 else [],
        "tunnel_resistance": _tunnel_resistance(top),
    }
    limits = {
        "speed": speed,
        "acceleration": acceleration,
        "deceleration": deceleration,
        "traction_efficiency": _efficiency(top, "efficiency traction"),
        "recovery_efficiency": _efficiency(top, "efficiency reg brake"),
    }
    return build_model(
        Consist,
        {
            "schema": "train_ato/consist/1",
            "name": name,
            "source": f"TTOBench train {name}, BSD-2-Clause; brake: electric and pneumatic service brake together",
            "vehicle_types": {"train": vehicle},
            "train": [{"type": "train"}],
            "emergency_brake": _emergency_brake(top, pneumatic / (mass * factor)),
            "plan_limits": {key: value for key, value in limits.items() if value is not None},
        },
        place,
    )


def rigid_train(place: str, name: str, source: str, **data: Any) -> Consist:
    """Return a train with rigid couplers from its vehicle types, its parts and other data."""
    gears = {"draft_gears": {"rigid": {"kind": "rigid"}}, "default_gear": "rigid"}
    raw = {"schema": "train_ato/consist/1", "name": name, "source": source}
    return build_model(Consist, raw | gears | data, place)


def _quantity(top: Fields, key: str, kind: str, low: float = 0.0, high: float = 1e12) -> float:
    """Return a quantity with its unit, in SI."""
    fields = top.below(key)
    value = fields.number("value") * _unit_factor(fields, "unit", kind)
    return finite_number(value, f"{fields.place}: value in SI", low, high)


def _unit_factor(fields: Fields, key: str, kind: str) -> float:
    return UNITS[kind][known_text(fields.text(key), f"{fields.place}: {key}", UNITS[kind])]


def _length(top: Fields, *, point_mass: bool) -> float:
    """Return the length of the train [m]; without a key, that of its coaches."""
    if "length" in top:
        return _quantity(top, "length", "length", low=1.0, high=1e4)
    if point_mass:
        return COACH_LENGTH
    if "num coaches" not in top:
        raise ValueError(
            f"{top.place}: length: this key is missing, and speed limits hold for the whole train; add "
            'length: {"unit": "m", "value": ...} or num coaches, or plan with --point-mass'
        )
    length = COACH_LENGTH * _quantity(top, "num coaches", "count", low=1.0, high=400.0)
    print_assumption(f"{top.place}: length is missing; assumed {length:g} m, {COACH_LENGTH:g} m per coach")
    return length


def _hyperbola(top: Fields, prefix: str, end: float) -> list[dict[str, float]]:
    force, power = (_quantity(top, f"{prefix} {kind}", kind, low=1.0) for kind in ("force", "power"))
    return hyperbola(force, power, end)


def hyperbola(force: float, power: float, end: float) -> list[dict[str, float]]:
    """Return an envelope up to a speed [m/s]: a constant force [N], then a constant power [W]."""
    corner = power / force
    if corner >= end:
        return [{"to": end, "force": force}]
    return [{"to": corner, "force": force}, {"to": end, "power": power}]


def _with_pneumatic(electric: list[dict[str, float]], pneumatic: float, bound: float) -> list[dict[str, float]]:
    """Return an electric envelope plus a constant force [N], at most ``bound`` [N]."""
    constant, end = electric[0]["force"], electric[-1]["to"]
    if constant + pneumatic <= bound:
        return [{**segment, "force": segment.get("force", 0.0) + pneumatic} for segment in electric]
    power = electric[-1].get("power", 0.0)
    corner = power / (bound - pneumatic) if bound > pneumatic else math.inf
    if len(electric) == 1 or corner >= end:
        return [{"to": end, "force": bound}]
    return [{"to": corner, "force": bound}, {"to": end, "power": power, "force": pneumatic}]


def _tunnel_resistance(top: Fields) -> list[dict[str, float]]:
    """Return cross section [m²] and coefficient [N s²/m²] of every entry, in the layouts 1.4 and 1.5."""
    if "tunnel resistance" not in top:
        return []
    fields = top.below("tunnel resistance")
    ranges = (0.1, 1e4), (0.0, 1e6)
    if fields.one_of("unit", "units") == "units":
        units, keys = fields.below("units"), ("cross section", "coefficient")
        rows = fields.table("values", *ranges)
    else:
        units, keys, columns = fields, ("cross section unit", "unit"), ("cross section", "value")
        pairs = [*zip(columns, ranges, strict=True)]
        rows = [[entry.number(key, None, *known) for key, known in pairs] for entry in fields.each("values", 1)]
    area, factor = _unit_factor(units, keys[0], "area"), _unit_factor(units, keys[1], "force per speed²")
    found = [{"cross_section": section * area, "coefficient": value * factor} for section, value in rows]
    return sorted(found, key=lambda entry: entry["cross_section"])


def _emergency_brake(top: Fields, pneumatic: float) -> dict[str, float]:
    """Return the friction emergency brake; ``pneumatic`` is the full pneumatic deceleration [m/s²].

    The deceleration of the ETCS data holds from the speed of its row on. The friction of the model falls with the
    speed, so the row with the smallest standstill value is decisive. The time is delay plus time constant.
    """
    default = EmergencyBrake()
    if "ETCS braking data" not in top:
        weaker = min(default.deceleration, pneumatic) if pneumatic > 0 else default.deceleration
        return {"deceleration": weaker}
    etcs = top.below("ETCS braking data")
    curve = etcs.below("A_brake_emergency")
    factor = _unit_factor(curve.below("units"), "velocity", "speed")
    unit = _unit_factor(curve.below("units"), "deceleration", "acceleration")
    rows = [(factor * velocity, unit * rate) for velocity, rate in curve.table("values", (0, 1e3), (1e-3, 10))]
    return emergency_brake(rows, _quantity(etcs, "T_be", "time", low=1e-3, high=60.0))


def emergency_brake(rows: Iterable[tuple[float, float]], time: float) -> dict[str, float]:
    """Return the emergency brake of ETCS data: rows of speed [m/s] and deceleration [m/s²], and build-up time [s]."""
    default = EmergencyBrake()
    whole = default.delay + default.time_constant
    return {
        "deceleration": min(value / shoe_force(1.0, speed) for speed, value in rows),
        "delay": time * default.delay / whole,
        "time_constant": time * default.time_constant / whole,
    }


def _efficiency(top: Fields, key: str) -> float | None:
    """Return an efficiency; a value up to 1 with the unit % is read as a fraction, as some files have it."""
    if key not in top:
        return None
    value = _quantity(top, key, "ratio", high=1.0)
    if value <= 0.01:
        print_assumption(f"{top.place}: {key} = {number_text(100 * value)} %: read as {number_text(100 * value)}")
        value *= 100.0
    return value
