"""Rolling stock of OSRD (RailJSON 3.2, Open Rail Association) as a train of one vehicle, and a train as one.

Efforts are in N over speeds in m/s, linear between their points. The first and the last effort apply beyond the points.
The Davis coefficients are in N, N/(m/s) and N/(m/s)². The service brake has ``const_gamma`` (2025; before: ``gamma``)
on a fall of 50 per mille too. A brake of type MAX has at most the force gamma times the inertial mass. The first curve
whose conditions are met is in effect, else the default curve of the mode. Figures without effect here, as
``startup_time``, are kept for the way back.
"""

import json
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from plant_sim.consist import PLAIN_SUPPLY, Consist, ForcePoints, PlanLimits, SupplyCurve, VehicleType
from plant_sim.elementary import plain_sum
from plant_sim.formats.fields import Fields, known_text, names_in, print_assumption
from plant_sim.formats.ttobench import BRAKED_GRADE, OVERSPEED, emergency_brake
from plant_sim.input_error import build_model, close_match
from plant_sim.traction import Envelope
from plant_sim.units import GRAVITY, number_text

CONDITIONS = {
    "comfort": "comfort", "electrical_profile_level": "electrical_level", "power_restriction_code": "power_restriction",
}  # fmt: skip
"""Key of a condition in the file, and in the consist."""
GAMMAS = ("const_gamma", "constant_gamma", "gamma")
USED = {"name", "mass", "length", "max_speed", "inertia_coefficient", "rolling_resistance", "effort_curves",
        "comfort_acceleration", *GAMMAS}  # fmt: skip
"""Keys with an effect; the others are kept."""
WITHOUT_EFFECT = {
    "railjson_version", "version", "locked", "id", "metadata", "loading_gauge", "startup_time", "startup_acceleration",
    "power_restrictions", "base_power_class", "energy_sources", "electrical_power_startup_time",
    "raise_pantograph_time", "supported_signaling_systems", "etcs_brake_params", "primary_category",
    "other_categories", "liveries", "subcategory",
}  # fmt: skip
"""Other keys of the schema."""
KEPT = "osrd"
ADDED: dict[str, Any] = {
    "railjson_version": "3.2", "locked": False, "startup_time": 0.0, "startup_acceleration": 0.0, "loading_gauge": "G1",
    "metadata": {},
}  # fmt: skip
"""Keys of a rolling stock without a figure in the consist."""
CARRIED = names_in("""
    comfort_acceleration, const_gamma, constant_gamma, gamma, id, inertia_coefficient, length, loading_gauge,
    locked, mass, max_speed, name, railjson_version, startup_acceleration, startup_time, version,
    effort_curves.{default_mode, modes.*.{curves[].{cond.{comfort, electrical_profile_level,
    power_restriction_code}, curve.{max_efforts, speeds}}, default_curve.{max_efforts, speeds}, is_electric}},
    etcs_brake_params.{gamma_emergency.{boundaries, values}, t_be}, gamma.{type, value}, rolling_resistance.{A, B,
    C, type}
""")
"""Keys that the consist carries, or that have a note of their own; the others are kept without effect."""
SAMPLES = 24
"""Points of a hyperbola; linear between them, its error is below 0.1 % for a speed ratio of 3."""
STEP, JUMP = 1e-3, 100.0
"""Rise of the speed in place of a step of the effort [m/s], because the format needs rising speeds; such a step [N]."""


def osrd_train(data: dict[str, Any], place: str, selection: str = "") -> Consist:
    """Return the train in the data of a rolling stock, with an effort curve of :func:`with_supply`."""
    top = Fields(data, place)
    mass, speed = top.number("mass", None, 1.0, 1e9), top.number("max_speed", None, 0.1, 200.0)
    factor = top.number("inertia_coefficient", None, 1.0, 2.0)
    davis = top.below("rolling_resistance")
    if davis.text("type") != "davis":
        raise ValueError(f"{davis.place}: type = '{davis.text('type')[:30]}': only davis is read; give A, B and C")
    davis.refuse_unknown("type", *"ABC")
    curves, default = _curves(top.below("effort_curves"))
    gamma, largest = _gamma(top)
    force = mass * factor * gamma + (0.0 if largest else mass * BRAKED_GRADE * GRAVITY)
    kept = {key: value for key, value in data.items() if key not in USED}
    if "gamma" in top and isinstance(data["gamma"], dict):
        kept["gamma"] = {key: value for key, value in data["gamma"].items() if key != "value"}
    vehicle = {
        "mass": mass,
        "length": top.number("length", None, 1.0, 1e5),
        "rotating_mass_factor": factor,
        "resistance": {"n": [davis.number(key, None, 0.0, 1e9) for key in "ABC"]},
        "traction": [],
        "brake": [{"to": OVERSPEED * speed, "force": force}],
        "supply_curves": curves,
    }
    raw = {
        "schema": "train_ato/consist/1",
        "name": top.text("name"),
        "source": f"OSRD rolling stock {Path(place).name}",
        "vehicle_types": {"train": vehicle},
        "train": [{"type": "train"}],
        "plan_limits": {"speed": speed, "deceleration": gamma}
        | (
            {"acceleration": acceleration}
            if (acceleration := top.number("comfort_acceleration", 0.0, 0.0, 10.0))
            else {}
        ),
        "emergency_brake": _etcs_brake(top),
        "kept": {KEPT: kept | {"default_mode": default}},
    }
    for key in sorted(set(kept) - WITHOUT_EFFECT):
        near = close_match(str(key), USED | WITHOUT_EFFECT)
        print_assumption(f"{place}: {str(key)[:40]}: no key of a rolling stock; kept without effect{near}")
    if unused := [key for key in ("startup_time", "startup_acceleration") if top.number(key, 0.0, 0.0, 1e4)]:
        print_assumption(f"{place}: {', '.join(unused)}: no effect here, as in OSRD's own run; kept for the way back")
    return with_supply(build_model(Consist, raw, place), selection or f"mode={default}", place)


def _curves(fields: Fields) -> tuple[list[dict[str, Any]], str]:
    """Return all curves in the order of their match, and the default mode."""
    fields.refuse_unknown("modes", "default_mode")
    modes, default = fields.below("modes"), fields.text("default_mode")
    if default not in modes.data:
        raise ValueError(f"{fields.place}: default_mode = '{default[:40]}': not in modes ({', '.join(modes.data)})")
    found = []
    for name in modes.data:
        mode = modes.below(name)
        mode.refuse_unknown("curves", "default_curve", "is_electric")
        if (electric := mode.required("is_electric")) not in (True, False):
            raise ValueError(f"{mode.place}: is_electric = {str(electric)[:20]!r}: must be true or false; correct it")
        of_mode = {"mode": str(name), "electric": bool(electric)}
        for curve in mode.each("curves"):
            curve.refuse_unknown("cond", "curve")
            conditions = curve.below("cond") if curve.data.get("cond") else Fields({}, curve.place)
            conditions.refuse_unknown(*CONDITIONS)
            held = {CONDITIONS[key]: conditions.text(key) for key in CONDITIONS if key in conditions}
            found.append(of_mode | held | _points(curve.below("curve")))
        found.append(of_mode | _points(mode.below("default_curve")))
    return found, default


def _points(fields: Fields) -> dict[str, list[float]]:
    fields.refuse_unknown("speeds", "max_efforts")
    speeds, efforts = (fields.numbers(key, 0.0, 1e9, 2) for key in ("speeds", "max_efforts"))
    if len(speeds) != len(efforts):
        raise ValueError(f"{fields.place}: {len(speeds)} speeds and {len(efforts)} max_efforts; give as many of both")
    for k, (before, after) in enumerate(pairwise(speeds), 1):
        if after <= before:
            raise ValueError(f"{fields.place}: speeds[{k}] = {number_text(after)}: speeds must rise; correct them")
    return {"speed": speeds, "force": efforts}


def _gamma(top: Fields) -> tuple[float, bool]:
    """Return the service deceleration [m/s²], and True if it bounds the brake force."""
    key = top.one_of(*GAMMAS)
    if key != "gamma" or not isinstance(top.data["gamma"], dict):
        return top.number(key, None, 1e-3, 10.0), False
    fields = top.below("gamma")
    kind = known_text(fields.text("type"), f"{fields.place}: type", ("CONST", "MAX"))
    return fields.number("value", None, 1e-3, 10.0), kind == "MAX"


def _etcs_brake(top: Fields) -> dict[str, float] | None:
    """Return the emergency brake of the ETCS data; without them that of the defaults."""
    if "etcs_brake_params" not in top:
        return None
    etcs = top.below("etcs_brake_params")
    curve = etcs.below("gamma_emergency")
    bounds, values = curve.numbers("boundaries", 0, 1e3, 0), curve.numbers("values", 1e-3, 10)
    if len(values) != len(bounds) + 1:
        raise ValueError(f"{curve.place}: {len(bounds)} boundaries need {len(bounds) + 1} values; correct them")
    if any(after <= before for before, after in pairwise([0.0, *bounds])):
        raise ValueError(f"{curve.place}: boundaries must rise from above 0; correct them")
    return emergency_brake(zip([0.0, *bounds], values, strict=True), etcs.number("t_be", None, 1e-3, 60.0))


def with_supply(consist: Consist, selection: str, place: str) -> Consist:
    """Return a train with the traction of the first curve that holds under some conditions.

    They are ``mode=25000V,comfort=HEATING,electrical_level=22500V,power_restriction=C1``, each where it is known. The
    mode alone needs no key. A condition that no curve has is refused.
    """
    known = [curve for kind in consist.vehicle_types.values() for curve in kind.supply_curves]
    keys = ("mode", *CONDITIONS.values())
    if not known:
        raise ValueError(f"{place}: selection '{selection}': the file has one train; remove it")
    chosen: dict[str, str] = {}
    for part in selection.split(","):
        key, mark, value = part.partition("=")
        key, value = (key, value) if mark else ("mode", key)
        values = sorted({str(getattr(curve, key)) for curve in known} - {"None"}) if key in keys else []
        if value not in values:
            fit = f"{key} is one of {', '.join(values)}" if key in keys else f"write {', '.join(keys)}"
            raise ValueError(f"{place}: selection '{part[:60]}': not in its effort curves; {fit}")
        if chosen.setdefault(key, value) != value:
            raise ValueError(f"{place}: selection '{selection[:60]}': {key} has two values; keep one")
    mode = chosen.setdefault("mode", str(consist.kept.get(KEPT, {}).get("default_mode", known[0].mode)))
    types = {}
    for name, kind in consist.vehicle_types.items():
        held = [
            curve
            for curve in kind.supply_curves
            if curve.mode == mode
            and all(getattr(curve, key) in (None, chosen.get(key)) for key in CONDITIONS.values())
        ]  # fmt: skip
        if kind.supply_curves and not held:
            raise ValueError(f"{place}: selection '{selection}': no effort curve without conditions in mode {mode}")
        if held:
            end = consist.plan_limits.speed if consist.plan_limits and consist.plan_limits.speed else 0.0
            change = {"traction": held[0].segments(end), "independent_power": not held[0].electric}
            kind = kind.model_copy(update=change)
        types[name] = kind
    return consist.model_copy(update={"vehicle_types": types})


def osrd_stock_json(consist: Consist) -> tuple[str, tuple[str, ...]]:
    """Return a train as rolling stock of OSRD, and the keys of the consist that it does not carry, or that it adds.

    A train without traction or service deceleration is refused.
    """
    kept = dict(consist.kept.get(KEPT, {}))
    default = kept.pop("default_mode", None)
    inertia = plain_sum(vehicle.inertia for vehicle in consist.vehicles)
    limits = consist.plan_limits or PlanLimits()
    davis = [vehicle.resistance.polynomial(vehicle.mass, consist.gravity) for vehicle in consist.vehicles]
    curves = consist.vehicles[0].supply_curves if len(consist.vehicles) == 1 else ()
    curves = curves or (_summed(consist),)
    deceleration = service_deceleration(consist, "OSRD")
    speed = limits.speed or curves[-1].speed[-1]
    old = kept.pop("gamma", None)
    added = {} if KEPT in consist.kept else dict(ADDED)
    if limits.acceleration is None:
        added["comfort_acceleration"] = curves[-1].force[0] / inertia
    data: dict[str, Any] = {
        "name": consist.name,
        "mass": consist.mass,
        "length": consist.length,
        "max_speed": speed,
        "inertia_coefficient": inertia / consist.mass,
        "rolling_resistance": {"type": "davis"}
        | {key: plain_sum(row[k] for row in davis) for k, key in enumerate("ABC")},
        "effort_curves": _effort_curves(curves, default),
        **({"gamma": {**old, "value": deceleration}} if old else {"const_gamma": deceleration}),
        **({"comfort_acceleration": limits.acceleration} if limits.acceleration is not None else {}),
    }
    text = json.dumps(data | kept | added, indent=1, ensure_ascii=False) + "\n"
    return text, (*_left_out(consist), *(f"added {key} = {value}" for key, value in added.items()))


def service_deceleration(consist: Consist, form: str) -> float:
    """Return the service deceleration [m/s²], which a format needs."""
    if consist.plan_limits is None or consist.plan_limits.deceleration is None:
        raise ValueError(
            f"train '{consist.name}': plan_limits.deceleration: this key is missing, and {form} needs it; add the "
            "service deceleration"
        )
    return consist.plan_limits.deceleration


def _summed(consist: Consist) -> SupplyCurve:
    """Return the traction of all power units as points."""
    units = [vehicle for vehicle in consist.vehicles if vehicle.traction]
    if not units:
        raise ValueError(f"train '{consist.name}': no vehicle has traction; OSRD needs a powered train")
    electric = not all(unit.independent_power for unit in units)
    speeds, forces = traction_points(units)
    return SupplyCurve(mode=PLAIN_SUPPLY[electric], electric=electric, speed=tuple(speeds), force=tuple(forces))


def traction_points(units: Sequence[VehicleType]) -> tuple[list[float], list[float]]:
    """Return rising speeds [m/s] and the traction of some units [N]; a hyperbola has :data:`SAMPLES` points."""
    envelopes = [Envelope(unit.traction) for unit in units]
    ends = sorted({0.0, *(segment.to for unit in units for segment in unit.traction)})
    curved = any(segment.power for unit in units for segment in unit.traction)
    speeds = [0.0]
    for begin, end in pairwise(ends):
        if abs(plain_sum(e.force(begin + STEP) - e.force(begin) for e in envelopes)) > JUMP and begin:
            speeds.append(begin + STEP)
        speeds += np.geomspace(max(begin, 0.05 * end), end, SAMPLES if curved else 2)[1:].tolist()
    return speeds, [plain_sum(envelope.force(v) for envelope in envelopes) for v in speeds]


def _effort_curves(curves: tuple[SupplyCurve, ...], default: str | None) -> dict[str, Any]:
    """Return the modes with their curves; the last one without conditions is the default curve of its mode."""
    modes: dict[str, Any] = {}
    for curve in curves:
        mode = modes.setdefault(curve.mode, {"curves": [], "default_curve": None, "is_electric": curve.electric})
        held = {key: getattr(curve, name) for key, name in CONDITIONS.items()}
        mode["curves"].append({"cond": held, "curve": _written(curve)})
    for mode in modes.values():
        free = [entry for entry in mode["curves"] if not any(entry["cond"].values())]
        mode["default_curve"] = free[-1]["curve"] if free else mode["curves"][-1]["curve"]
        if free:
            mode["curves"].remove(free[-1])
    return {"modes": modes, "default_mode": default or next(iter(modes))}


def _written(curve: ForcePoints) -> dict[str, list[float]]:
    return {"speeds": list(curve.speed), "max_efforts": list(curve.force)}


def lost_of_train(consist: Consist, *used: str) -> list[str]:
    """Return the keys of a consist that a foreign rolling stock does not carry; ``used`` are carried ones."""
    carried = {"schema_", "name", "vehicle_types", "train", "gravity", "plan_limits", "source", *used}
    found = [key for key in type(consist).model_fields if key not in carried and getattr(consist, key)]
    if consist.plan_limits and (consist.plan_limits.traction_efficiency or consist.plan_limits.recovery_efficiency):
        found.append("plan_limits: efficiencies")
    if consist.gravity != GRAVITY:
        found.append(f"gravity = {number_text(consist.gravity)} (now {number_text(GRAVITY)})")
    for key in ("electric_brake", "shoes", "adhesive_mass", "tunnel_resistance", "notches"):
        found += [f"vehicle_types.{name}.{key}" for name, kind in consist.vehicle_types.items() if getattr(kind, key)]
    return found


def _left_out(consist: Consist) -> list[str]:
    """Return the keys of a consist that a rolling stock of OSRD does not carry."""
    etcs = "etcs_brake_params" in consist.kept.get(KEPT, {})  # the source of the emergency brake goes back unchanged
    found = lost_of_train(consist, "kept", *(("emergency_brake",) if etcs else ()))
    kinds = consist.vehicle_types.items()
    if len(consist.vehicles) > 1:
        found.append(f"train: {len(consist.vehicles)} vehicles (now one)")
        found += [f"vehicle_types.{name}.supply_curves" for name, kind in kinds if kind.supply_curves]
    if len({vehicle.independent_power for vehicle in consist.vehicles if vehicle.traction}) > 1:
        found.append("vehicle_types: independent_power of some units (now all from the line)")
    if KEPT not in consist.kept:
        found += [f"vehicle_types.{name}.brake (now const_gamma)" for name, kind in kinds if kind.brake]
    return found
