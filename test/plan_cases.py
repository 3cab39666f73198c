"""Random lines and trains for the planner's property tests."""

import numpy as np
from plant_trains import line_of, train_of

from plant_sim.consist import Consist
from plant_sim.line import Line
from train_ato.profile.planner.planner import Plan
from train_ato.profile.planner.settings import PlanSettings


def random_train(rng: np.random.Generator, vehicles: int) -> tuple[Consist, float]:
    """Return a train and its acceleration at low speed [m/s²]."""
    top, mass = float(rng.uniform(15, 90)), float(rng.uniform(20, 100)) * 1e3
    start = float(rng.uniform(0.1, 1.3))
    pull = start * vehicles * mass * 1.05 + vehicles * mass * 9.81 * 0.003
    corner = top * float(rng.uniform(0.2, 0.8))
    traction = [{"to": corner, "force": pull}, {"to": top, "power": pull * corner}]
    if rng.random() < 0.3:  # an envelope in steps
        traction = [{"to": part * top, "force": pull * left} for part, left in ((0.3, 1), (0.6, 0.7), (1, 0.45))]
    fading = [{"to_kmh": 5, "slope_kn_per_kmh": pull * 1.1 / 5e3}] if rng.random() < 0.2 else []
    resistance = [float(rng.uniform(*span)) for span in ((0.5, 3), (0, 0.02), (1e-4, 1e-3))]
    engine = {
        "mass": mass, "length": float(rng.uniform(10, 28)), "rotating_mass_factor": float(rng.uniform(1, 1.15)),
        "resistance": {"n_per_kn_kmh": resistance}, "traction": traction,
        "brake": [*fading, {"to": 1.1 * top, "force": pull * 1.1}],
    }  # fmt: skip
    wagon = {"mass": mass, "length": float(rng.uniform(10, 28)), "resistance": {"n_per_kn_kmh": [1.0, 0.005, 0.0003]}}
    return train_of({"engine": engine, "wagon": wagon}, 1, vehicles - 1), start


def random_line(rng: np.random.Generator, steepest: float) -> Line:
    """Return a line of 0.2 to 50 km with limits, grades, curves and up to five stops."""
    length = float(10 ** rng.uniform(2.3, 4.7))
    limits = np.sort(rng.uniform(0, length, int(rng.integers(1, 15))))
    limits[0] = 0
    grades = np.sort(rng.uniform(0, length, int(rng.integers(1, 15))))
    stops = np.unique(np.round([0, *rng.uniform(0, length, int(rng.integers(0, 4))), length], 1))
    stops = stops[np.concatenate(([True], np.diff(stops) > 5))]
    return line_of(
        length + 1,
        grades=[{"at": float(at), "grade": float(rng.uniform(-steepest, steepest))} for at in grades],
        curves=[
            {"begin": float(at), "end": float(at + rng.uniform(20, 500)), "radius": float(rng.uniform(150, 2000))}
            for at in rng.uniform(0, length, 3)
        ],
        speed_limits=[{"at": float(at), "speed": float(rng.uniform(4, 80))} for at in limits],
        stops=[{"at": float(at), "dwell": float(rng.uniform(0, 30))} for at in stops],
    )


def random_case(seed: int) -> tuple[Line, Consist, PlanSettings]:
    """Return a line, a train and settings."""
    rng = np.random.default_rng(seed)
    vehicles = int(rng.integers(1, 12)) if rng.random() < 0.7 else int(rng.integers(30, 110))
    consist, start = random_train(rng, vehicles)
    line = random_line(rng, min(0.03, start / 9.81 * 0.8))
    settings = PlanSettings(
        jerk=float(10 ** rng.uniform(-1.3, 0.3)) if rng.random() < 0.9 else None,
        acceleration=float(rng.uniform(0.2, 1.5)),
        deceleration=float(rng.uniform(0.2, 1.3)),
        force_margin=float(rng.uniform(0, 0.3)),
    )
    return line, consist, settings


def limit_by_hand(line: Line, front: float, length: float, top: float) -> float:
    """Return the lowest speed limit under the train, from the line file [m/s]."""
    limits = line.speed_limits
    ends = [limit.at for limit in limits[1:]] + [np.inf]
    under = [
        limit.speed
        for limit, end in zip(limits, ends, strict=True)
        if limit.at < front - 1e-6 and end > front - length + 1e-6
    ]
    return min([top, *under])


def resistance_by_hand(line: Line, consist: Consist, front: float, speed: float) -> float:
    """Return running, grade and curve resistance, vehicle by vehicle, without the tables of the planner [N]."""
    total = 0.0
    half = consist.vehicles[0].length / 2
    for vehicle, offset in zip(consist.vehicles, consist.offsets, strict=True):
        place = front - half - offset
        grade = 0.0
        for entry in line.grades:
            if entry.at <= place < line.end and place >= line.begin:
                grade = entry.grade
        curve = sum(0.6 / curve.radius for curve in line.curves if curve.begin <= place < curve.end)
        a, b, c = vehicle.resistance.polynomial(vehicle.mass, consist.gravity)
        total += a + b * speed + c * speed**2 + vehicle.mass * consist.gravity * (grade + curve)
    return total


def broken_promises(line: Line, consist: Consist, settings: PlanSettings, plan: Plan, period: float) -> list[str]:
    """Return the violated properties of a plan."""
    speed, acceleration = plan.profile.velocity, plan.profile.acceleration
    traction, electric, air = plan.train.forces_at(speed)
    keep, moving, braking = 1 - settings.force_margin, speed > 0.05, electric + air
    hardest = int(np.argmin(acceleration))
    braked = plan.force[hardest] < -1  # uphill a train may slow down faster by itself
    found = {
        "traction less its margin": np.any((plan.force - keep * traction)[moving] > 1e-5 * traction.max()),
        "brake less its margin": np.any((-plan.force - keep * braking)[moving] > 1e-5 * braking.max()),
        "limit": np.any(speed > plan.limit + 1e-4),
        "jerk": settings.jerk and np.abs(np.diff(acceleration)).max() > settings.jerk * period * (1 + 1e-5),
        "acceleration": acceleration.max() > (settings.acceleration or np.inf) * (1 + 1e-6),
        "deceleration": braked and -acceleration[hardest] > (settings.deceleration or np.inf) * (1 + 1e-6),
        "rest at the end": speed[-1] != 0 or speed.min() < 0,
    }
    for place, arrival, departure in plan.arrivals[1:]:
        knot = int(np.ceil(arrival / period - 1e-9))
        found[f"stop at {place}"] = knot * period <= departure and abs(plan.front[knot] - place) > 1e-6
    return [name for name, broken in found.items() if broken]
