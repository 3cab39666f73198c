"""Networks and trains of ALTRIOS (NREL): links with heights, headings and speed limits; locomotives and rail vehicles.

A link is a track in one direction. Its ``idx_flip`` is the same track in the other direction. Heights are linear
between their points. A curve is the change of the heading over its length. The change is taken between -180° and 180°;
ALTRIOS counts a heading that passes north as a curve of almost 360°. The curve resistance is that of ALTRIOS: linear
below 1° per 100 ft and quadratic above, with the coefficients that its rail vehicles share.

The drag of a rail vehicle is ``cd_area`` times density times v², without the factor one half. ALTRIOS gives the rolling
resistance of the cars to the locomotives too, and no drag.
"""

import math
from itertools import count, groupby, pairwise
from pathlib import Path
from typing import Any

from plant_sim.consist import Consist
from plant_sim.elementary import plain_sum
from plant_sim.formats.fields import Fields, keys_not_carried, names_in, print_assumption
from plant_sim.formats.network_path import BEGIN, END, ROUNDING, STRAIGHT, Network, Range, TrackPath, network_line
from plant_sim.formats.ttobench import BRAKED_GRADE, OVERSPEED, hyperbola, rigid_train
from plant_sim.line import MAX_GRADE, Line
from plant_sim.units import GRAVITY, number_text

AIR_DENSITY = 1.225
CURVE = (0.056, 0.4387579, 0.01025485)
"""Coefficients of the curve resistance over the weight, for curvatures in rad/m."""
ONE_DEGREE = math.radians(1.0) / 30.48
"""Curvature of 1° per 100 ft [rad/m]."""
CATEGORY = "Freight"
"""Speed set of a network with several, without a category in the selection."""
CARRIED_LINK = names_in("""
    [].{elevs[].{elev_meters, offset_meters}, headings[].{heading_radians, offset_meters}, idx_curr, idx_flip,
    idx_next, idx_next_alt, idx_prev, idx_prev_alt, length_meters, speed_set.{is_head_end,
    speed_limits[].{offset_end_meters, offset_start_meters, speed_meters_per_second}}, speed_sets.*.{is_head_end,
    speed_limits[].{offset_end_meters, offset_start_meters, speed_meters_per_second}}}
""")
"""Keys of a link that the line carries; ``idx_prev`` follows from the others."""


def links_of(data: Any) -> list[dict[str, Any]] | None:
    """Return the links in the data of a file; None for another file."""
    if isinstance(data, dict):
        data = data.get("network")
    if isinstance(data, list) and len(data) == 2 and isinstance(data[1], list):
        data = data[1]
    links = data if isinstance(data, list) else []
    keys = {"idx_next", "length_meters"}
    return links if any(isinstance(link, dict) and keys <= link.keys() for link in links) else None


def altrios_line(data: Any, place: str, selection: str = "", *, against: bool = False) -> tuple[Line, tuple[str, ...]]:
    """Return the line along a path, and the keys that it does not carry.

    A path has numbers of links, perhaps with a speed set: ``71..557,Local``; ``against`` has the flipped links.
    """
    selection, category = (part.strip() for part in selection.partition(",")[::2])
    known = _known(links_of(data) or [], place)
    network = Network(place, {name: link.number("length_meters", None, 1e-6, 1e7) for name, link in known.items()})
    for name, link in known.items():
        for key in ("idx_next", "idx_next_alt"):
            if not (other := link.data.get(key)):
                continue
            if str(other) not in known:
                raise ValueError(f"{link.place}: {key} = {str(other)[:20]}: no link of this network; correct it")
            network.join((name, END), (str(other), BEGIN), both=False)
    path = network.path(selection)
    if against:
        flips = [str(known[name].required("idx_flip")) for name, _ in reversed(path.parts)]
        if not set(flips) <= set(known):
            raise ValueError(f"{place}: a link of the path has no idx_flip; name a path of this direction FROM..TO")
        path = TrackPath(network, [(name, True) for name in flips])
        path.check_joints()
    grades: list[Range] = []
    curves: list[dict[str, Any]] = []
    limits: list[Range] = []
    by_category: dict[str, list[Range]] = {}
    others: set[str] = set()
    at = 0.0
    for name, _ in path.parts:
        link = known[name]
        grades += [Range(at + a, at + b, rise / (b - a), link.place) for a, b, rise in _changes(link, "elev")]
        curves += [curve for a, b, turn in _changes(link, "heading") for curve in _curve(at + a, at + b, turn)]
        limits += _limits(link, at, category, others)
        for name_of_set in link.data.get("speed_sets") or {}:
            by_category.setdefault(str(name_of_set), []).extend(_limits(link, at, str(name_of_set), others))
        at += network.lengths[name]
    line = network_line(
        path, "ALTRIOS network", selection, against=against, grades=grades, radii=[], speeds=limits,
        sections={"curves": curves}, by_category=by_category,
    )  # fmt: skip
    used = [known[name].data for name, _ in path.parts]
    left = [*keys_not_carried(used, CARRIED_LINK), *sorted(others)]
    print_assumption(f"{place}: curve resistance of ALTRIOS with the coefficients {', '.join(map(str, CURVE))}")
    return line, tuple(dict.fromkeys(left))


def _known(links: list[Any], place: str) -> dict[str, Fields]:
    """Return the links by their number, without the empty one of number 0."""
    known: dict[str, Fields] = {}
    for k, data in enumerate(links):
        link = Fields(data, f"{place}: link {data.get('idx_curr')}" if isinstance(data, dict) else f"{place}: [{k}]")
        if (number := link.text("idx_curr")) in known:
            raise ValueError(f"{link.place}: idx_curr = {number[:20]}: two links have this number; correct one")
        known[number] = link
    known.pop("0", None)
    return known


def _changes(link: Fields, what: str) -> list[tuple[float, float, float]]:
    """Return begin and end on a link [m], and the change between them, of heights [m] or headings [rad]."""
    key, unit = (f"{what}s", {"elev": "elev_meters", "heading": "heading_radians"}[what])
    rows = link.each(key)
    most = 1e4 if what == "elev" else 6.3  # headings are between -pi and 2 pi
    points = [(row.number("offset_meters", None, -1e-3, 1e7), row.number(unit, None, -most, most)) for row in rows]
    if len(points) < 2 and what == "elev":
        print_assumption(f"{link.place}: {key}: fewer than two; assumed level")
    for k, ((a, before), (b, after)) in enumerate(pairwise(points), 1):
        if b <= a:
            raise ValueError(f"{link.place}: {key}[{k}]: offset_meters = {number_text(b)}: must rise; correct it")
        if what == "elev" and abs(after - before) > MAX_GRADE * (b - a):
            raise ValueError(
                f"{link.place}: {key}[{k}]: {unit} = {number_text(after)}: {number_text(after - before)} m on "
                f"{number_text(b - a)} m; correct it"
            )
    length = link.number("length_meters")
    if points and (abs(points[0][0]) > ROUNDING or abs(points[-1][0] - length) > ROUNDING):
        raise ValueError(
            f"{link.place}: {key}: from {number_text(points[0][0])} to {number_text(points[-1][0])} m of a link of "
            f"{number_text(length)} m; give them from 0 to its length"
        )
    return [(a, b, after - before) for (a, before), (b, after) in pairwise(points)]


def _curve(begin: float, end: float, turn: float) -> list[dict[str, Any]]:
    """Return the curve of a change of heading [rad]; none for a straight stretch."""
    wrapped = (turn + math.pi) % (2 * math.pi) - math.pi
    curvature = abs(wrapped) / (end - begin)
    if curvature < 1 / STRAIGHT:
        return []
    radius = max(1 / curvature, 5.0)
    resistance = curve_resistance(curvature)
    side = "right" if wrapped > 0 else "left"
    return [{"begin": begin, "end": end, "radius": radius, "side": side, "resistance_n_per_kn": 1e3 * resistance}]


def curve_resistance(curvature: float) -> float:
    """Return the curve resistance of ALTRIOS over the weight at a curvature [rad/m]."""
    sharp = max(curvature - ONE_DEGREE, 0.0)
    return CURVE[0] * min(curvature, ONE_DEGREE) + CURVE[1] * sharp + CURVE[2] * sharp * sharp


def _limits(link: Fields, at: float, category: str, others: set[str]) -> list[Range]:
    """Return the speed limits of a link on the path; ``others`` takes the keys that are not carried."""
    if link.data.get("speed_sets"):
        link.one_of("speed_sets", "speed_set")
        sets = link.below("speed_sets")
        chosen = category or (CATEGORY if CATEGORY in sets else next(iter(sets.data), ""))
        if chosen not in sets:
            raise ValueError(f"{link.place}: speed_sets: '{chosen[:30]}' is none of {', '.join(sets.data)}")
        if not category and chosen != CATEGORY:
            print_assumption(f"{link.place}: speed_sets: no '{CATEGORY}'; limits of '{chosen}'")
        chosen_set, chosen_name = sets.below(chosen), f"[].speed_sets.{chosen}"
    elif "speed_set" in link:
        chosen_set, chosen_name = link.below("speed_set"), "[].speed_set"
    else:
        return []
    if chosen_set.data.get("is_head_end"):
        others.add(f"{chosen_name}.is_head_end")
    found = []
    for entry in chosen_set.each("speed_limits"):
        begin = entry.number("offset_start_meters", None, -1e-3, 1e7)
        end = entry.number("offset_end_meters", None, begin, link.number("length_meters") + ROUNDING)
        speed = entry.number("speed_meters_per_second", None, 0.1, 300.0)
        found.append(Range(at + begin, at + end, speed, entry.place))
    return found


def is_altrios_train(data: dict[str, Any]) -> bool:
    """Return True if the data of a file are a train of ALTRIOS: its configuration, perhaps with locomotives."""
    config = data.get("train_config", data)
    return isinstance(config, dict) and "rail_vehicles" in config and "n_cars_by_type" in config


CARRIED_TRAIN = names_in("""
    {, train_config.}{n_cars_by_type.*, rail_vehicles[].{axle_count, bearing_res_per_axle_newtons, braking_ratio,
    car_type, cd_area_square_meters, davis_b_seconds_per_meter, length_meters, mass_freight_kilograms,
    mass_rot_per_axle_kilograms, mass_static_base_kilograms, rolling_ratio, speed_max_meters_per_second}},
    loco_con.loco_vec[].{force_max, force_max_newtons, mass, mass_kilograms, pwr_out_max_watts,
    loco_type.{BatteryElectricLoco, ConventionalLoco, HybridLoco}.{edrv, fc, res}.pwr_out_max_watts}, train_id
""")
LOCOMOTIVE_LENGTH = 22.0
"""Assumed length of a locomotive, which ALTRIOS does not have [m]."""


def altrios_train(data: dict[str, Any], place: str) -> Consist:
    """Return the train in the data of a file; the locomotives are at its head."""
    top = Fields(data, place)
    config = top.below("train_config") if "train_config" in top else top
    counts = config.below("n_cars_by_type")
    kinds: dict[str, dict[str, Any]] = {}
    parts: list[dict[str, Any]] = []
    speeds: list[float] = []
    brake = 0.0
    cars = config.each("rail_vehicles", 1)
    counts.refuse_unknown(*(car.text("car_type") for car in cars))
    for car in cars:
        name, count = car.text("car_type"), counts.whole(car.text("car_type"), 0, 5000)
        if name in kinds:
            raise ValueError(f"{car.place}: car_type = '{name[:40]}': two entries have this type; correct one")
        axles = car.whole("axle_count", 1, 64)
        mass = car.number("mass_static_base_kilograms", None, 500, 1e6) + car.number(
            "mass_freight_kilograms", 0, 0, 1e6
        )
        rolling = [
            car.number(key, 0.0, 0, most) * mass * GRAVITY
            for key, most in (("rolling_ratio", 0.1), ("davis_b_seconds_per_meter", 0.01))
        ]
        kinds[name] = {
            "mass": mass,
            "length": car.number("length_meters", None, 1, 100),
            "rotating_mass_factor": 1 + axles * car.number("mass_rot_per_axle_kilograms", 0.0, 0, 1e4) / mass,
            "resistance": {"n": [
                axles * car.number("bearing_res_per_axle_newtons", 0.0, 0, 1e4) + rolling[0], rolling[1],
                AIR_DENSITY * car.number("cd_area_square_meters", 0.0, 0, 100),
            ]},
        }  # fmt: skip
        for key, own in zip(("curve_coeff_0", "curve_coeff_1", "curve_coeff_2"), CURVE, strict=True):
            if car.number(key, own) != own:
                print_assumption(f"{car.place}: {key}: the curves of a line have {own}; no effect")
        speeds.append(car.number("speed_max_meters_per_second", 100.0, 0.1, 200))
        brake += count * mass * GRAVITY * car.number("braking_ratio", 0.0, 0, 1)
        parts += [{"type": name, "count": count}] if count else []
    towed = plain_sum(part["count"] * kinds[part["type"]]["mass"] for part in parts)
    if not towed:
        raise ValueError(f"{counts.place}: no cars; give the number of every car_type")
    ratio = plain_sum(
        part["count"] * car.number("rolling_ratio", 0.0) * kinds[part["type"]]["mass"] / towed
        for part in parts
        for car in cars
        if car.text("car_type") == part["type"]
    )  # fmt: skip
    heads = _locomotives(top, kinds, ratio, max(min(speeds), 1.0), brake)
    parts = [*heads, *parts]
    inertia = plain_sum(
        part["count"] * kinds[part["type"]]["mass"] * kinds[part["type"]].get("rotating_mass_factor", 1.0)
        for part in parts
    )
    limits = {"speed": min(speeds)} | ({"deceleration": brake / inertia} if brake else {})
    print_assumption(f"{place}: rigid couplers; the friction brake of the cars acts in the locomotives")
    name, source = top.text("train_id", Path(place).stem), f"ALTRIOS train {Path(place).name}"
    return rigid_train(place, name, source, vehicle_types=kinds, train=parts, plan_limits=limits)


def _locomotives(
    top: Fields, kinds: dict[str, dict[str, Any]], ratio: float, speed: float, brake: float
) -> list[dict[str, Any]]:
    """Return the parts of the locomotives, whose types are added to ``kinds``; equal ones are one type."""
    if "loco_con" not in top:
        raise ValueError(f"{top.place}: loco_con: no locomotives; add loco_con: {{loco_vec: [...]}}")
    rows, names = top.below("loco_con").each("loco_vec", 1), list[str]()
    for k, loco in enumerate(rows):
        mass, force = (
            loco.number(loco.one_of(f"{key}_{unit}", key), None, 1e3, high)
            for key, unit, high in (("mass", "kilograms", 1e6), ("force_max", "newtons", 1e8))
        )
        power = loco.number("pwr_out_max_watts", None, 2e4, 1e9) if "pwr_out_max_watts" in loco else _drive(loco)
        end = OVERSPEED * speed
        kind = {
            "mass": mass, "length": LOCOMOTIVE_LENGTH, "traction": hyperbola(force, power, end),
            "independent_power": True,
            "resistance": {"n": [ratio * mass * GRAVITY, 0.0, 0.0]},
            "brake": [{"to": end, "force": (brake + BRAKED_GRADE * GRAVITY * mass) / len(rows)}],
        }  # fmt: skip
        free = next(name for n in count(k) if (name := f"locomotive {n}") not in kinds)
        same = next((name for name, other in kinds.items() if other == kind), free)
        kinds[same] = kind
        names.append(same)
    print_assumption(f"{top.place}: locomotives of {LOCOMOTIVE_LENGTH:g} m")
    return [{"type": name, "count": len(list(group))} for name, group in groupby(names)]


def _drive(loco: Fields) -> float:
    """Return the largest power of the electric drivetrain of a locomotive, or of its source [W]."""
    kind = loco.below("loco_type")
    found = [
        kind.below(name).below(part).number("pwr_out_max_watts", None, 2e4, 1e10)
        for name in kind.data
        for part in ("edrv", "res", "fc")
        if part in kind.below(name)
    ]
    if not found:
        raise ValueError(f"{kind.place}: no edrv with pwr_out_max_watts; give pwr_out_max_watts of the locomotive")
    return min(found)
