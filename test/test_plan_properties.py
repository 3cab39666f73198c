"""Properties of every plan: a better train is never slower, on any line and with any jerk limit."""

from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from plan_cases import limit_by_hand, random_case
from plant_trains import line_of as own_line
from plant_trains import train_of

from plant_sim.consist import Consist
from plant_sim.library import load_consist, load_line
from plant_sim.line import Line, reversed_line
from train_ato.profile.planner.jerk_limit import _faster
from train_ato.profile.planner.line_tables import LineForce, SpeedLimits
from train_ato.profile.planner.planner import net_energy_bound, plan_profile
from train_ato.profile.planner.settings import PlanSettings
from train_ato.profile.planner.train_tables import TrainTables

CAR = 25.0
"""Length of a car of the train by hand [m]."""
REFUSED = (5, 13, 24, 26, 27, 52)
"""Random cases without a plan: a steep line, or a brake that fades."""
ROUNDING = 1.001
"""Relative running time that counts as equal: the window of the jerk limit follows the largest acceleration."""


def scaled(
    consist: Consist, traction: float = 1.0, brake: float = 1.0, mass: float = 1.0, power: float = 1.0
) -> Consist:
    """Return a train with its forces, the power of its constant-power segments, or its masses multiplied."""
    data = consist.model_dump(by_alias=True)
    for vehicle in data["vehicle_types"].values():
        vehicle["mass"] *= mass
        for key, factor in (("traction", traction), ("brake", brake)):
            for segment in vehicle[key]:
                for part in ("force", "slope_kn_per_kmh", "power"):
                    segment[part] *= factor
        for segment in vehicle["traction"]:
            segment["power"] *= power
    return Consist.model_validate(data)


def metro(power: float, *between: dict[str, float]) -> Consist:
    """Return a metro of four motor and two trailer cars with a constant power [W] per motor car from 40 km/h on."""
    resistance = {"n_per_kn_kmh": [2.0, 0.02, 0.0005]}
    traction = [{"to_kmh": 40, "force_kn": 60}, *between, {"to_kmh": 90, "power": power}]
    motor = {
        "mass": 38000, "length": 20, "rotating_mass_factor": 1.1, "resistance": resistance, "traction": traction,
        "brake": [{"to_kmh": 90, "force_kn": 60}],
    }  # fmt: skip
    return train_of({"motor": motor, "trailer": {"mass": 32000, "length": 20, "resistance": resistance}}, 4, 2)


def line_of(end: float = 12e3, **keys: Any) -> Line:
    """Return a line with a limit of 80 km/h and two stops, changed by keys."""
    usual = {"stops": [{"at": 200}, {"at": 8000}], "speed_limits": [{"at": 0, "speed_kmh": 80}]}
    return own_line(end, **usual | keys)


def never_slower(line: Line, trains: list[Consist], settings: PlanSettings) -> list[float]:
    """Return the running times of better and better trains [s], or fail."""
    times = [plan_profile(line, consist, settings).running_time for consist in trains]
    assert all(late <= early * ROUNDING for early, late in pairwise(times)), times
    return times


def check_jerk_limit(line: Line, factors: tuple[float, ...], jerk: float) -> None:
    """Check that more power, up to a thousandfold step, costs no time, and the jerk limit 3 % at most."""
    trains = [metro(660e3 * factor) for factor in factors]
    times, free = (never_slower(line, trains, PlanSettings(jerk=limit)) for limit in (jerk, None))
    assert (np.array(times) / np.array(free) - 1.0).max() < 0.03


@pytest.mark.parametrize("jerk", [0.2, 0.5, 3.0])
def test_a_step_of_the_traction_envelope_makes_no_train_slower(jerk: float) -> None:
    """Breaks if the averaging takes away the force below a step: 1118 s for 665 s on a line of four sections."""
    line = line_of(grades=[{"at_km": 1, "grade_permille": 12}])
    check_jerk_limit(line, (0.6, 1.0, 1.5, 2.0, 4.0, 10.0, 1000.0), jerk)


@pytest.mark.parametrize("kind", ["adhesion", "power_limits"])
def test_a_step_of_the_envelope_takes_no_force_from_a_section_with_little(kind: str) -> None:
    """Breaks if a section takes the part of the upper side of a step from the lower side too: 135 s for 119 s."""
    begin, end, value = {"adhesion": (100, 700, {"factor": 0.5}), "power_limits": (250, 1500, {"power_kw": 1500})}[kind]
    line = line_of(stops=[{"at": 200}, {"at": 2200}], **{kind: [{"begin": begin, "end": end, **value}]})
    check_jerk_limit(line, (0.8, 1, 1.5, 3, 10), 0.8)


@pytest.mark.parametrize(("end", "begin", "to", "largest"), [(2.2, 900, 1000, 1e-4), (2.44, 949, 1186, 1e-3)])
def test_much_power_after_a_dead_section_makes_no_train_slower(
    end: float, begin: float, to: float, largest: float
) -> None:
    """Breaks if the window of the whole run follows the change of force at one place: .11 and .34 % slower."""
    line = line_of(1e3 * end, stops=[{"at": 200}, {"at": 1e3 * end}], neutral_sections=[{"begin": begin, "end": to}])
    times = [plan_profile(line, metro(660e3 * factor), PlanSettings()).running_time for factor in (1, 3, 10)]
    assert times[2] <= times[1] * (1 + largest) < times[0]


def test_a_segment_of_one_kmh_with_twice_the_force_is_no_obstacle() -> None:
    """Breaks if a narrow step takes away the force around it."""
    never_slower(line_of(), [metro(660e3), metro(660e3, {"to_kmh": 41, "force_kn": 120})], PlanSettings())


def test_more_force_without_service_limits_is_never_slower() -> None:
    """Breaks if the window of the jerk limit grows with an acceleration that is of no use."""
    consist, line = load_consist("xuzhou_metro_3"), load_line("xuzhou_metro_test")
    settings = PlanSettings(acceleration=None, deceleration=None)
    never_slower(line, [scaled(consist, factor, factor) for factor in (1, 1.2, 1.5, 2, 4, 8, 16)], settings)


@pytest.mark.parametrize(
    "seed", [0, 4, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(60) if seed not in REFUSED)]
)
def test_a_better_train_or_line_is_never_slower(seed: int) -> None:
    """Breaks if more traction, more brake, less mass, higher limits or more jerk lengthen a random run."""
    line, consist, settings = random_case(seed)
    first = plan_profile(line, consist, settings).running_time
    limits = tuple(each.model_copy(update={"speed": 1.1 * each.speed}) for each in line.speed_limits)
    faster = line.model_copy(update={"speed_limits": limits})
    looser = settings.model_copy(update={"jerk": None if settings.jerk is None else 1.3 * settings.jerk})
    found = {
        "traction": plan_profile(line, scaled(consist, traction=1.2), settings),
        "brake": plan_profile(line, scaled(consist, brake=1.2), settings),
        "mass": plan_profile(line, scaled(consist, mass=0.9), settings),
        "limits": plan_profile(faster, consist, settings),
        "jerk": plan_profile(line, consist, looser),
    }
    times = {key: result.running_time for key, result in found.items()}
    assert max(times.values()) <= first * ROUNDING, (times, first)


def test_the_search_brakes_beside_a_section_where_nothing_is_recovered() -> None:
    """Breaks if the search takes friction brakes in a neutral section for electric ones: 2.415 for 1.981 kWh."""
    line = line_of(
        stops=[{"at": 200}, {"at": 4200}],
        speed_limits=[{"at": 0, "speed_kmh": 100}],
        grades=[{"at": 0, "grade_permille": -8}],
        neutral_sections=[{"begin": 3400, "end": 3900, "electric_brake": False}],
    )
    train = train_of({"car": railcar(electric_brake=[{"to_kmh": 165, "force_kn": 40}])}, 2)
    found = plan_profile(line, train, PlanSettings(efficiency=0.85, recovered=0.7, time=215.06)).summary()
    assert found["energy_net_kwh"] < 2.0


def railcar(*traction: dict[str, float], **more: Any) -> dict[str, Any]:
    """Return a motor car of 60 t, 50 kN and 625 kW, or with another envelope."""
    own = traction or ({"to_kmh": 45, "force_kn": 50}, {"to_kmh": 160, "power_kw": 625})
    return {
        "mass_t": 60, "length": CAR, "rotating_mass_factor": 1.08, "resistance": {"n": [700, 20, 2.0]},
        "traction": own, "brake": [{"to_kmh": 165, "force_kn": 60}], **more,
    }  # fmt: skip


def shortest_time(line: Line, car: dict[str, Any], cars: int, service: tuple[float, float], step: float = 0.5) -> float:
    """Return the shortest running time between the stops of a level line [s], by two passes over the places."""
    # Every car has its own place; the train is a list of equal motor cars, its front starts and ends at rest.
    # The adhesion and the power have one section each at most.
    begin, end = (stop.at for stop in line.stops)
    edges = np.linspace(begin, end, int((end - begin) / step) + 1)
    step = float(edges[1] - edges[0])
    centres = 0.5 * (edges[1:] + edges[:-1])[:, None] - CAR * (np.arange(cars) + 0.5)

    def within(entries: Any) -> Any:
        inside = ((centres >= entry.begin) & (centres < entry.end) for entry in entries)
        return sum(inside, np.zeros(centres.shape, bool)).sum(axis=1)

    alive = (cars - within(line.neutral_sections)).tolist()
    narrow = car.get("tunnel_resistance", [{"coefficient": 0.0}])[0]["coefficient"]
    air = (narrow * within(line.tunnels) + cars * car["resistance"]["n"][2]).tolist()
    inertia = cars * car["mass_t"] * 1e3 * car["rotating_mass_factor"]
    a, b, _ = (cars * value for value in car["resistance"]["n"])

    def pull(speed: float) -> float:
        for segment in car["traction"]:
            if speed <= segment["to_kmh"] / 3.6:
                return float(1e3 * (segment.get("force_kn", 0.0) + segment.get("power_kw", 0.0) / max(speed, 0.1)))
        return 0.0

    poor, weak = within(line.adhesion).tolist(), within(line.power_limits).tolist()
    factor = line.adhesion[0].factor if line.adhesion else 1.0
    power = line.power_limits[0].power / cars if line.power_limits else np.inf

    def rate(k: int, at: float, *, brakes: bool) -> float:
        speed = (2 * at) ** 0.5
        force = 60e3 if brakes else pull(speed)
        grip = factor * (0.161 + 7.5 / (3.6 * speed + 44)) * car["mass_t"] * 9810
        whole = poor[k] * min(force, grip) - poor[k] * force
        if brakes:
            whole += cars * force
        else:
            whole += alive[k] * force + weak[k] * (min(force, power / max(speed, 0.1)) - force)
        resistance = a + b * speed + air[k] * speed**2
        return min((whole + (resistance if brakes else -resistance)) / inertia, service[brakes])

    def passed(order: Any, ceiling: list[float], *, brakes: bool) -> list[float]:
        energy = [0.0]
        for k in order:
            at = energy[-1]
            for part in (0.5, 1.0):
                at = max(energy[-1] + part * step * rate(k, at, brakes=brakes), 1e-9)
            energy.append(min(at, ceiling[k if brakes else k + 1]))
        return energy

    top = min(limit.speed for limit in line.speed_limits)
    cells = range(edges.size - 1)
    highest = passed(reversed(cells), [top**2 / 2] * edges.size, brakes=True)[::-1]
    energy = passed(cells, highest, brakes=False)
    speed = np.sqrt(2 * np.array(energy))
    return float((2 * step / (speed[1:] + speed[:-1])).sum())


def obstacles(seed: int) -> tuple[Line, dict[str, Any]]:
    """Return a level line with dead sections and tunnels, and a motor car with steps in its envelope."""
    rng = np.random.default_rng(seed)
    at = np.sort(rng.uniform(300, 3500, 4))
    neutral = [{"begin": float(at[k]), "end": float(at[k] + rng.uniform(20, 250))} for k in (0, 2)]
    lengths = [(k, rng.uniform(200, 900)) for k in (1, 3)]
    tunnels = [{"begin": at[k], "end": at[k] + length, "cross_section": 40.0} for k, length in lengths]
    limits = [{"at": 0, "speed_kmh": rng.uniform(60, 140)}]
    line = line_of(stops=[{"at": 200}, {"at": 4200}], speed_limits=limits, neutral_sections=neutral, tunnels=tunnels)
    low, high = sorted(rng.uniform(20, 70, 2))
    power = float(rng.uniform(0.5, 2.0)) * low / 3.6 * 50
    steps = [
        {"to_kmh": float(low), "force_kn": 50.0},
        {"to_kmh": float(high) + 1.0, "force_kn": float(rng.uniform(30, 70))},
        {"to_kmh": 160, "power_kw": power},
    ]
    return line, railcar(*steps, tunnel_resistance=[{"cross_section": 40.0, "coefficient": float(rng.uniform(1, 8))}])


def test_cars_outside_a_dead_section_draw_the_train() -> None:
    """Breaks if a unit without power takes the force of all: no start with three of four cars outside."""
    line = line_of(neutral_sections=[{"begin": 5700, "end": 6300}])
    consist = train_of({"car": railcar()}, 4)
    found = plan_profile(line, consist, PlanSettings(begin=5720.0, jerk=None, force_margin=0.0))
    inside = found.front - CAR / 2 < 5700 + CAR
    moving = inside & (found.profile.velocity > 0.1)
    assert found.force[moving].max() == pytest.approx(150e3, rel=1e-3)


STOPS, MOVE = [{"at": 500}, {"at": 6000}, {"at": 11000}], ".*; move the stop or the section$"


@pytest.mark.parametrize(("sections", "words"), [
    ({"stops": STOPS, "neutral_sections": [{"begin": 5900, "end": 6100}]},
     f"need 3 kN.*is 0 kN in the neutral section from km 5.900 to{MOVE}"),
    ({"stops": STOPS, "adhesion": [{"begin": 5800, "end": 6200, "factor": 0.001}]},
     f"need 3 kN.*is 1 kN in the section with low adhesion{MOVE}"),
    ({"stops": STOPS, "power_limits": [{"begin": 5800, "end": 6200, "power": 0.001}]},
     f"need 3 kN.*is 0 kN in the power limit from km 5.800{MOVE}"),
    ({"grades": [{"at": 0, "grade_permille": 30}], "neutral_sections": [{"begin": 3000, "end": 5000}]},
     "is 0 kN in the neutral section from km 3.000 to km 5.000; shorten the"),
])  # fmt: skip
def test_a_stop_or_stall_without_force_names_its_section(sections: dict[str, Any], words: str) -> None:
    """Breaks if the message has the force of the open line, or advises more traction: it needs 3 kN and has 180."""
    with pytest.raises(ValueError, match=words):
        plan_profile(line_of(**sections), train_of({"car": railcar()}, 4))


def test_a_stall_at_the_end_of_a_dead_section_names_it() -> None:
    """Breaks if the last cell of a section has its reserve but not its name: `reduce the mass` was the remedy."""
    passes, stalls, refused = 1.0, 1.4, []
    for _ in range(7):  # towards the train that stalls at the very end
        permille = (passes + stalls) / 2
        grades = [{"at": 0, "grade_permille": 0}, {"at": 2800, "grade_permille": permille}]
        dead = [{"begin": 2800, "end": 3000}]
        line = line_of(4e3, grades=grades, neutral_sections=dead, stops=[{"at": 2600}, {"at": 3300}])
        try:
            plan_profile(line, train_of({"car": railcar()}, 1), PlanSettings(speed_max=3.0))
            passes = permille
        except ValueError as error:
            stalls = permille
            refused.append(str(error))
    assert 1.0 < passes < stalls < 1.4
    assert all("is 0 kN in the neutral section from km 2.800 to km 3.000; shorten the" in text for text in refused)


@pytest.mark.parametrize("jerk", [None, 0.5])
@pytest.mark.parametrize("seed", [0, 4])
def test_the_energy_is_that_of_the_written_profile(seed: int, jerk: float | None) -> None:
    """Breaks if the figure is a sum over the knots: 0.6 % beside the work of the profile."""
    # The work of the profile between its knots is summed in steps of 1 ms, on a line without grades.
    line, car = obstacles(seed)
    consist = train_of({"car": {**car, "tunnel_resistance": []}}, 4)
    result = plan_profile(line, consist, PlanSettings(jerk=jerk))
    stamps = result.profile.start + 0.001 * np.arange(int(1000 * result.running_time))
    _, speed, _ = result.profile.at_times(stamps)
    resistance = 4 * (700 + 20 * speed + 2 * speed**2)
    force = np.gradient(speed, 0.001) * 4 * 60e3 * 1.08 + resistance
    work = float(np.maximum(force * speed, 0).sum() * 0.001) / 3.6e6
    assert result.summary()["energy_kwh"] == pytest.approx(work, rel=5e-4)


def test_many_limits_are_read_by_place() -> None:
    """Breaks if a limit holds for a part of the train only: every one is compared with every place by hand."""
    rng = np.random.default_rng(1)
    at = [0.0, *np.sort(rng.uniform(0, 9000, 200)).tolist()]
    line = line_of(speed_limits=[{"at": place, "speed": float(rng.uniform(5, 40))} for place in at])
    front = np.sort(rng.uniform(-500, 9500, 500))
    train = TrainTables(train_of({"car": railcar()}, 4))
    by_hand = [limit_by_hand(line, place, 100.0, train.speed_max) for place in front.tolist()]
    assert SpeedLimits(line, train.speed_max).at(front, 100.0) == pytest.approx(by_hand)


FREE = PlanSettings(jerk=None, force_margin=0.0)


@pytest.mark.parametrize("seed", [0, 1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(2, 30))])
def test_the_shortest_time_with_tunnels_dead_sections_and_steps_is_found(seed: int) -> None:
    """Breaks if one car in a dead section takes the force of all, or the air of a tunnel counts at another speed."""
    line, car = obstacles(seed)
    found = plan_profile(line, train_of({"car": car}, 4), FREE).running_time
    assert found == pytest.approx(shortest_time(line, car, 4, (1.0, 0.8)), rel=3e-3)


@pytest.mark.parametrize(("kind", "begin", "end", "value"), [
    ("adhesion", 200, 2500, 0.35), ("adhesion", 1000, 2500, 0.3), ("adhesion", 0, 4500, 0.25),
    ("power_limits", 200, 2500, 900e3), ("power_limits", 1000, 3000, 600e3),
])  # fmt: skip
def test_the_shortest_time_with_low_adhesion_or_power_is_found(
    kind: str, begin: float, end: float, value: float
) -> None:
    """Breaks if a place keeps its largest reserve of all speeds: 3.7, 1.1 and 11 % more time with low adhesion."""
    entry = {"begin": begin, "end": end, "factor" if kind == "adhesion" else "power": value}
    line = line_of(stops=[{"at": 200}, {"at": 4200}], speed_limits=[{"at": 0, "speed_kmh": 140}], **{kind: [entry]})
    car = railcar({"to_kmh": 45, "force_kn": 70}, {"to_kmh": 160, "power_kw": 875})
    found = plan_profile(line, train_of({"car": car}, 4), FREE).running_time
    assert found == pytest.approx(shortest_time(line, car, 4, (1.0, 0.8)), rel=3e-3)


@pytest.mark.parametrize(
    ("factor", "least"),
    [*(pytest.param(*row, marks=pytest.mark.slow) for row in ((1.05, 31.781), (1.1, 27.701))), (1.2, 22.094)],
)
def test_the_energy_in_tunnels_is_that_of_an_independent_optimum(factor: float, least: float) -> None:
    """Breaks if the air of a tunnel has the speed of full traction: 1.7 to 2.6 % above the optimum."""
    # The optima in kWh are those of linear programs in sequence with its tunnels, ``studies_done/plan_optimum.py``.
    line, car = obstacles(0)
    line = line.model_copy(update={"neutral_sections": ()})
    consist = train_of({"car": railcar(tunnel_resistance=car["tunnel_resistance"])}, 4)
    fastest = plan_profile(line, consist, FREE).running_time
    found = plan_profile(line, consist, FREE.model_copy(update={"time": factor * fastest}))
    assert found.energy / 3.6e6 == pytest.approx(least, rel=3e-3)
    if factor == 1.05:
        assert 0.98 * found.energy < net_energy_bound(found) <= 1.0005 * least * 3.6e6


OPTIMA = (
    30.442, 28.452, 13.810, 20.077, 46.549, 12.507, 26.758, 19.402, 13.546, 13.749, 21.478, 17.619, 34.557, 36.954,
    17.567, 18.920, 16.924, 26.050, 22.687, 15.500, 26.403, 35.739, 11.969, 16.308, 39.783, 18.073, 17.625, 14.597,
    31.041, 12.656,
)  # fmt: skip
"""Optima with obstacles [kWh], by linear programs in sequence: ``studies_done/plan_optimum.py --obstacles 30``."""


@pytest.mark.parametrize("seed", [1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(30) if seed != 1)])
def test_the_energy_with_tunnels_dead_sections_and_steps_is_that_of_an_independent_optimum(seed: int) -> None:
    """Breaks if a timetable on a line with obstacles needs .3 % more than car by car; every third one recovers."""
    line, car = obstacles(seed)
    consist, more = train_of({"car": car}, 4), {"efficiency": 0.85, "recovered": 0.7} if seed % 3 == 2 else {}
    settings = FREE.model_copy(update=more)
    time = (1.05, 1.1, 1.2, 1.3)[seed % 4] * plan_profile(line, consist, settings).running_time
    found = plan_profile(line, consist, settings.model_copy(update={"time": time})).energy / 3.6e6
    assert 0.997 * OPTIMA[seed] <= found <= 1.003 * OPTIMA[seed]


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(1, 10))])
def test_more_time_is_never_dearer(seed: int) -> None:
    line, car = obstacles(seed)
    consist = train_of({"car": car}, 4)
    fastest = plan_profile(line, consist)
    times = [factor * fastest.running_time for factor in (1.05, 1.15, 1.3)]
    found = [plan_profile(line, consist, PlanSettings(time=time)).energy for time in times]
    assert all(more <= less * ROUNDING for less, more in pairwise([fastest.energy, *found]))


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(1, 5))])
def test_the_reverse_of_the_reverse_is_the_line(seed: int) -> None:
    """Breaks if a reversal moves a place by more than rounding: the plans of both lines have the same time."""
    line, car = obstacles(seed)
    twice = reversed_line(reversed_line(line))
    times = [plan_profile(entry, train_of({"car": car}, 4)).running_time for entry in (line, twice)]
    assert times[0] == pytest.approx(times[1], rel=1e-6)
    grids = np.linspace(200, 4200, 400)
    limits = [SpeedLimits(entry, 60.0).at(grids + 0.01, 100.0) for entry in (line, twice)]
    assert limits[0] == pytest.approx(limits[1])


@pytest.mark.parametrize("seed", [0, 1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(2, 30))])
def test_a_jerk_limit_costs_three_percent_at_most(seed: int) -> None:
    """Breaks if the jerk limit loses time where the line leaves room: sections of 4 km with steps and obstacles."""
    line, car = obstacles(seed)
    consist = train_of({"car": car}, 4)
    smooth, free = (plan_profile(line, consist, PlanSettings(jerk=jerk)).running_time for jerk in (0.5, None))
    assert smooth <= 1.03 * free


@pytest.mark.parametrize("works", [False, True])
def test_the_electric_brake_recovers_nothing_where_it_is_off(works: bool) -> None:
    """Breaks if friction brakes in a neutral section count as electric: 13.3 in place of 16.7 kWh net."""
    # By hand: the force of the written profile in steps of 1 ms; the electric brake of a car in the section is 0.
    electric = [{"to_kmh": 165, "force_kn": 25}]
    line = line_of(
        stops=[{"at": 200}, {"at": 4200}],
        speed_limits=[{"at": 0, "speed_kmh": 100}],
        neutral_sections=[{"begin": 3700, "end": 4150, "electric_brake": works}],
    )
    found = plan_profile(line, train_of({"car": railcar(electric_brake=electric)}, 2), PlanSettings())
    stamps = found.profile.start + 0.001 * np.arange(int(1000 * found.running_time))
    place, speed, _ = found.profile.at_times(stamps)
    force = np.gradient(speed, 0.001) * 2 * 60e3 * 1.08 + 2 * (700 + 20 * speed + 2 * speed**2)
    cars = place[:, None] - np.array([0.0, CAR])
    acting = 2.0 if works else ((cars < 3700) | (cars >= 4150)).sum(axis=1)
    work = float((np.minimum(np.maximum(-force, 0), 25e3 * acting) * speed).sum() * 0.001) / 3.6e6
    assert found.summary()["energy_electric_brake_kwh"] == pytest.approx(work, rel=5e-3)


def test_the_faster_of_two_ways_to_limit_the_jerk() -> None:
    """Breaks if a way without a window hides the one that has a window, or the slower one is taken."""
    slow, quick = (SimpleNamespace(time=lambda seconds=seconds: seconds) for seconds in (90.0, 80.0))
    pairs = [(slow, None), (None, slow), (slow, quick), (quick, slow), (None, None)]
    assert [_faster(*pair) for pair in pairs] == [slow, slow, quick, quick, None]
    assert _faster(slow, SimpleNamespace(time=lambda: 90.0)) is slow


def test_the_steps_of_the_force_of_a_line_are_those_of_grade_and_curve_together() -> None:
    """Breaks if a curve that takes over from a grade is a step, or a step of one of both is none."""
    curves = [{"begin": begin, "end": begin + 500.0, "radius": 200.0} for begin in (1000.0, 2000.0)]
    grades = [{"at": 0.0, "grade": 0.005}, {"at": 1000.0, "grade": 0.002}]  # as much less as 600 / 200 N/kN of a curve
    line = own_line(4000.0, grades=grades, curves=curves)
    consist = load_consist("crh380a_one_mass")
    force, middle = LineForce(line, TrainTables(consist)), consist.length / 2
    assert force.steps() - middle == pytest.approx([0.0, 1500.0, 2000.0, 2500.0, 4000.0], abs=1e-6)
    places = middle + np.array([500.0, 1200.0, 1700.0, 2200.0])
    weight = consist.vehicles[0].mass * 9.8
    assert force.at(places) == pytest.approx(weight * np.array([5e-3, 5e-3, 2e-3, 5e-3]), rel=1e-12)
