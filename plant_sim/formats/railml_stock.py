"""Trains in railML 3 (rolling stock): a formation of vehicles.

Weights are in t, speeds in km/h, forces in N or kN. A vehicle has its gross weight, or its tare weight if the gross
weight is missing. The running resistance of the formation (Davis, in N and km/h) is shared by weight. Without it the
sum of the vehicles is used: ``rollingResistance`` in N/kN and half of density times ``airDragCoefficient`` times
``crossSectionArea``. The traction is that of the primary mode of every engine, as a table, or its largest effort and
power. Equal brakes of the powered vehicles give the mean deceleration of the formation, also on a fall of 50 per mille.
"""

from itertools import pairwise
from pathlib import Path
from typing import Any

from plant_sim.consist import Consist
from plant_sim.elementary import plain_sum
from plant_sim.formats.fields import known_text, names_in, print_assumption
from plant_sim.formats.railml2 import DAVIS, read_railml
from plant_sim.formats.railml_collection import Entry
from plant_sim.formats.railtoolkit import ROTATING
from plant_sim.formats.ttobench import BRAKED_GRADE, OVERSPEED, hyperbola, rigid_train
from plant_sim.units import GRAVITY, KMH

AIR_DENSITY = 1.225
SPEEDS = {"km/h": 1 / KMH, "m/s": 1.0}
FORCES = {"N": 1.0, "kN": 1e3}
MODE = "engine.powerMode"
MODES = {"electric": False, "diesel": True, "battery": True}
"""Modes of power, True for one that needs no power of the line."""
TABLE = "tractionData.details.tractiveEffort.valueTable"
CARRIED = names_in("""
    rollingstock.{formations.formation.{@id, @speed, trainBrakes.{@meanDeceleration, @regularBrakePercentage},
    trainEngine.@maxAcceleration, trainOrder.{@orderNumber, @vehicleRef},
    trainResistance.daviesFormulaFactors.{@constantFactorA, @massDependent, @speedDependentFactorB,
    @squareSpeedDependentFactorC}}, vehicles.vehicle.{@bruttoWeight, @id, @length, @maximumAxleLoad,
    @rotatingMassFactor, @speed, @tareWeight, drivingResistance.info.{@airDragCoefficient, @crossSectionArea,
    @rollingResistance}, engine.powerMode.{@isPrimaryMode, @mode,
    tractionData.{details.tractiveEffort.valueTable.{@xValueUnit, @yValueUnit, valueLine.{@xValue,
    value.@yValue}}, info.{@maxTractiveEffort, @tractivePower}}}}}
""")


def railml_train(path: Path, selection: str = "") -> tuple[Consist, str, tuple[str, ...]]:
    """Return the formation of an identifier, or the only one; the format; and the names that it does not carry."""
    place = str(path)
    root, form, left = read_railml(path, CARRIED)
    if next(root.below("rollingstock"), None) is None:
        raise ValueError(f"{place}: holds a line (railML), no train; exchange them")
    formations = {_id(entry): entry for entry in root.below("formation")}
    if len(formations) != 1 and selection not in formations:
        raise ValueError(
            f"{place}: {len(formations)} formations ({', '.join(formations)[:200] or 'add one'}); name one as FILE:ID"
        )
    if selection and selection not in formations:
        raise ValueError(f"{place}: selection '{selection[:60]}': the file has {', '.join(formations)}; correct it")
    name = selection or next(iter(formations))
    data = _consist(formations[name], root)
    consist = rigid_train(place, name, f"{form} rolling stock {path.name}", **data)
    return consist, form, tuple(key for key in left if key != "@version")


def _id(element: Entry) -> str:
    if not (name := element.get("id")):
        raise ValueError(f"{element.file}: {element.tag}: it has no id; add one")
    return name


def _consist(formation: Entry, root: Entry) -> dict[str, Any]:
    """Return the data of a train."""
    known: dict[str, Entry] = {}
    place, where = formation.file, formation.place
    for entry in root.below("vehicle"):
        if (key := _id(entry)) in known:
            raise ValueError(f"{place}: vehicle {key}: two vehicles have this id; correct one")
        known[key] = entry
    order = formation.parts("trainOrder")
    order.sort(key=lambda entry: entry.number("orderNumber", 0, 1e5))
    for before, after in pairwise(order):
        if before.number("orderNumber") == after.number("orderNumber"):
            raise ValueError(f"{place}: trainOrder: orderNumber = {after.get('orderNumber')}: two have it; correct one")
    train = [entry.get("vehicleRef") for entry in order]
    if not train or not set(train) <= set(known):
        wrong = next((key for key in train if key not in known), None)
        what = "trainOrder: none" if wrong is None else f"vehicleRef = '{wrong[:40]}': no vehicle"
        raise ValueError(f"{where}: {what}; it has {', '.join(known)[:200] or 'no vehicle'}")
    types = {key: _vehicle(known[key]) for key in dict.fromkeys(train)}
    vehicles = [types[key] for key in train]
    mass = plain_sum(vehicle["mass"] for vehicle in vehicles)
    _share_resistance(formation, types, mass)
    limits = [known[key].number("speed", 1, 1000) / KMH for key in types if known[key].get("speed")]
    limits += [formation.number("speed", 1, 1000) / KMH] if formation.get("speed") else []
    powered = [key for key in train if "traction" in types[key]]
    brakes = formation.first("trainBrakes")
    if not powered or not limits or brakes is None:
        lacks = "engine of a vehicle" if not powered else "trainBrakes" if brakes is None else "speed"
        raise ValueError(f"{where}: {lacks}: missing; add it")
    deceleration, speed = brakes.number("meanDeceleration", 1e-3, 10), min(limits)
    inertia = plain_sum(vehicle["mass"] * vehicle["rotating_mass_factor"] for vehicle in vehicles)
    force = brake_share(deceleration, inertia, mass, len(powered))
    for key in set(powered):
        types[key]["brake"] = [{"to": OVERSPEED * speed, "force": force}]
    engine = formation.first("trainEngine")
    loaded = [known[key] for key in types if known[key].get("maximumAxleLoad")]
    loads = [entry.number("maximumAxleLoad", 0.1, 100) for entry in loaded]
    rating: dict[str, float] = {"axle_load_t": max(loads)} if loads else {}
    if brakes.get("regularBrakePercentage"):
        rating["brake_percentage"] = brakes.number("regularBrakePercentage", 1, 500)
    plan = {"speed": speed, "deceleration": deceleration}
    if engine is not None and engine.get("maxAcceleration"):
        plan["acceleration"] = engine.number("maxAcceleration", 1e-3, 10)
    print_assumption(f"{place}: rigid couplers; the brake of the formation acts in its powered vehicles")
    data = {"vehicle_types": types, "train": [{"type": key} for key in train], "plan_limits": plan}
    return data | ({"rating": rating} if rating else {})


def brake_share(deceleration: float, inertia: float, mass: float, units: int) -> float:
    """Return the brake force of each unit [N] for a service deceleration of the train, also on a steep fall."""
    return (inertia * deceleration + mass * BRAKED_GRADE * GRAVITY) / units


def _vehicle(vehicle: Entry) -> dict[str, Any]:
    """Return the data of a vehicle type, without its brake."""
    weight = "bruttoWeight" if vehicle.get("bruttoWeight") else "tareWeight"
    mass = 1e3 * vehicle.number(weight, 0.1, 1000)
    if vehicle.get("bruttoWeight") and vehicle.get("tareWeight"):
        print_assumption(f"{vehicle.file}: vehicles with load (bruttoWeight); tareWeight has no effect")
    traction = _traction(vehicle)
    factor = ROTATING["traction unit" if traction else "passenger"]
    if vehicle.get("rotatingMassFactor"):
        factor = vehicle.number("rotatingMassFactor", 1, 2)
    else:
        print_assumption(f"{vehicle.place}: no rotatingMassFactor; assumed {factor:g}")
    info = vehicle.first("drivingResistance.info")
    resistance = [0.0, 0.0, 0.0]
    if info is not None:
        area = info.number("airDragCoefficient", 0, 10) * info.number("crossSectionArea", 0, 100)
        rolling = info.number("rollingResistance", 0, 100) * mass * GRAVITY / 1e3
        resistance = [rolling, 0.0, 0.5 * AIR_DENSITY * area]
    return {
        "mass": mass,
        "length": vehicle.number("length", 0.1, 1000),
        "rotating_mass_factor": factor,
        "resistance": {"n": resistance},
        **traction,
    }


def _share_resistance(formation: Entry, types: dict[str, dict[str, Any]], mass: float) -> None:
    """Give the vehicles the running resistance of the formation, by their weight."""
    davis = formation.first("trainResistance.daviesFormulaFactors")
    if davis is None:
        if lacking := [key for key, kind in types.items() if not kind["resistance"]["n"][0]]:
            raise ValueError(
                f"{formation.place}: daviesFormulaFactors: missing, and vehicle {lacking[0]} has no "
                "drivingResistance; add one of them"
            )
        return
    if davis.flag("massDependent"):
        text = "daviesFormulaFactors: massDependent = true: is not read; give the factors in N"
        raise ValueError(f"{formation.file}: {text}")
    if any(kind["resistance"]["n"][0] for kind in types.values()):
        print_assumption(f"{formation.file}: drivingResistance of vehicles: no effect beside that of the formation")
    whole = [davis.number(key, 0, 1e9) * KMH**power for power, key in enumerate(DAVIS)]
    for kind in types.values():
        kind["resistance"] = {"n": [value * kind["mass"] / mass for value in whole]}


def _traction(vehicle: Entry) -> dict[str, Any]:
    """Return traction and supply of the primary mode of an engine; nothing without an engine."""
    modes = [mode for engine in vehicle.parts("engine") for mode in engine.parts("powerMode")]
    if not modes:
        return {}
    primary = [mode for mode in modes if mode.flag("isPrimaryMode", default=len(modes) == 1)]
    if len(primary) != 1:
        raise ValueError(f"{vehicle.place}: powerMode: {len(primary)} primary modes; mark one")
    mode = known_text(primary[0].get("mode"), f"{vehicle.place}: mode", MODES)
    supply = {"independent_power": MODES[mode]}
    table = primary[0].first(TABLE)
    if table is None:
        info = primary[0].first("tractionData.info")
        if info is None:
            raise ValueError(f"{vehicle.place}: tractionData: neither info nor a table; add one of them")
        force, power = (
            info.number(key, 1e3, most) for key, most in (("maxTractiveEffort", 1e7), ("tractivePower", 1e9))
        )
        end = OVERSPEED * vehicle.number("speed", 1, 1000) / KMH
        return {"traction": hyperbola(force, power, end), **supply}
    units = [
        known[known_text(table.get(key), f"{vehicle.place}: {key}", known)]
        for key, known in (("xValueUnit", SPEEDS), ("yValueUnit", FORCES))
    ]
    rows = [(line, line.parts()) for line in table.parts("valueLine")]
    if len(rows) < 2 or any(len(values) != 1 for _, values in rows):
        raise ValueError(f"{vehicle.place}: valueTable: give two valueLine or more, each with one value")
    return {
        "traction": {
            "speed": [line.number("xValue", 0, 1000) * units[0] for line, _ in rows],
            "force": [value.number("yValue", 0, 1e7) * units[1] for _, (value,) in rows],
        },
        **supply,
    }
