"""Trains of TTOBench up to layout 1.5: a point mass with forces, powers and efficiencies (JSON, BSD-2).

The train becomes one vehicle. Its brake envelope is the electric plus the pneumatic service brake, up to the service
deceleration on a fall of 50 per mille. The emergency brake is that of the ETCS data, else the weaker one of pneumatic
brake and default. Tunnel coefficients are added to the quadratic running resistance.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from plant_sim.brake_data import EmergencyBrake
from plant_sim.consist import Consist
from plant_sim.formats.fields import Fields, finite_number
from plant_sim.formats.notes import print_assumption
from plant_sim.formats.read_train import ReadTrain
from plant_sim.input_error import build_model
from plant_sim.number_text import number_text
from plant_sim.railway import shoe_force
from plant_sim.units import GRAVITY

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
CARRIED_TRAIN = (
    "metadata.id", "length", "mass", "rho", "max traction power", "max reg braking power", "max traction force",
    "max reg braking force", "max pn braking force", "max speed", "rolling resistance r0", "rolling resistance r1",
    "rolling resistance r2", "tunnel resistance", "ETCS braking data.A_brake_emergency", "ETCS braking data.T_be",
)  # fmt: skip
"""Keys of a train that the consist carries."""
PLAN_ONLY = ("max acceleration", "max deceleration")
"""Keys that are limits of a plan, not of the consist; the deceleration also bounds the brake envelope."""


def is_ttobench_train(data: dict[str, Any]) -> bool:
    """Return True if the data of a file are a train of this library."""
    return "max traction force" in data and "rolling resistance r0" in data


def ttobench_train(data: dict[str, Any], place: str, point_mass: bool = False) -> ReadTrain:
    """Return the train in the data of a file.

    Parameters
    ----------
    data, place
        Data of the file, and its name.
    point_mass
        Accept a train without a length, which a point mass does not use.

    Raises
    ------
    ValueError
        One line with location, key, value and remedy.
    """
    top = Fields(data, place)
    mass = _quantity(top, "mass", "mass", low=1.0)
    factor = 1.0 + (_quantity(top, "rho", "ratio", high=1.0) if "rho" in top else 0.0)
    speed = _quantity(top, "max speed", "speed", low=0.1, high=200.0)
    acceleration, deceleration = (
        _quantity(top, key, "acceleration", low=1e-3, high=10.0) if key in top else None for key in PLAN_ONLY
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
        "length": _length(top, point_mass),
        "rotating_mass_factor": factor,
        "resistance": {"n": resistance},
        "traction": _hyperbola(top, "max traction", speed),
        "brake": _with_pneumatic(electric, pneumatic, bound),
        "electric_brake": electric if pneumatic > 0 else [],
        "tunnel_resistance": _tunnel_resistance(top),
    }
    consist = build_model(
        Consist,
        {
            "schema": "train_ato/consist/1",
            "name": name,
            "source": f"TTOBench train {name}, BSD-2-Clause; brake: electric and pneumatic service brake together",
            "vehicle_types": {"train": vehicle},
            "train": [{"type": "train"}],
            "emergency_brake": _emergency_brake(top, pneumatic / (mass * factor)),
        },
        place,
    )
    return ReadTrain(
        consist,
        deceleration,
        speed,
        acceleration,
        _efficiency(top, "efficiency traction"),
        _efficiency(top, "efficiency reg brake"),
    )


def _quantity(top: Fields, key: str, kind: str, low: float = 0.0, high: float = 1e12) -> float:
    """Return a quantity with its unit, in SI."""
    fields = top.below(key)
    value = fields.number("value") * _unit_factor(fields, "unit", kind)
    return finite_number(value, f"{fields.place}: value in SI", low, high)


def _unit_factor(fields: Fields, key: str, kind: str) -> float:
    unit = fields.text(key)
    if unit not in UNITS[kind]:
        raise ValueError(f"{fields.place}: {key} = '{unit[:40]}': must be one of {', '.join(UNITS[kind])}")
    return UNITS[kind][unit]


def _length(top: Fields, point_mass: bool) -> float:
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
    """Return an envelope up to a speed [m/s]: a constant force, then a constant power."""
    force = _quantity(top, f"{prefix} force", "force", low=1.0)
    power = _quantity(top, f"{prefix} power", "power", low=1.0)
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
    rows: list[tuple[Any, Any]]
    if "units" in fields:
        units = fields.below("units")
        area, factor = (
            _unit_factor(units, "cross section", "area"),
            _unit_factor(units, "coefficient", "force per speed²"),
        )
        rows = [(row[0], row[1]) for row in fields.rows("values", 2)]
    else:
        area = _unit_factor(fields, "cross section unit", "area")
        factor = _unit_factor(fields, "unit", "force per speed²")
        entries = [Fields(entry, f"{fields.place}: values[{k}]") for k, entry in enumerate(fields.entries("values"))]
        rows = [(entry.required("cross section"), entry.required("value")) for entry in entries]
    found = []
    for k, (section, coefficient) in enumerate(rows):
        place = f"{fields.place}: values[{k}]"
        found.append(
            {
                "cross_section": finite_number(section, f"{place}: cross section", 0.1, 1e4) * area,
                "coefficient": finite_number(coefficient, f"{place}: coefficient", 0.0, 1e6) * factor,
            }
        )
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
    smallest = math.inf
    for k, (velocity, deceleration) in enumerate(curve.rows("values", 2)):
        speed = factor * finite_number(velocity, f"{curve.place}: values[{k}][0]", 0, 1e3)
        value = unit * finite_number(deceleration, f"{curve.place}: values[{k}][1]", 1e-3, 10)
        smallest = min(smallest, value / shoe_force(1.0, speed))
    time = _quantity(etcs, "T_be", "time", low=1e-3, high=60.0)
    whole = default.delay + default.time_constant
    return {
        "deceleration": smallest,
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
