"""Plan of a journey assembled from the sections between its stops: profile, forces, arrivals and figures.

Places in settings and lines refer to the front of the train; the profile refers to the centre of vehicle 0.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from plant_sim.elementary import plain_sum
from plant_sim.line import Line
from train_ato.messages.types import Array
from train_ato.profile.planner.driving_strategy import DrivingStrategy, SectionInputs
from train_ato.profile.planner.jerk_limit import fit_jerk_limit
from train_ato.profile.planner.line_tables import PlaceLimits
from train_ato.profile.planner.section import PlanSection, weighted_energy
from train_ato.profile.planner.settings import PlanSettings
from train_ato.profile.planner.train_tables import TrainTables
from train_ato.profile.profile import Profile, knot_count


@dataclass(frozen=True, slots=True)
class Plan:
    """Planned speed profile with its forces and stops.

    Attributes
    ----------
    profile : Profile
        Speed profile of vehicle 0's centre.
    force : Array, shape (n,)
        Own force of the train at every knot [N], > 0 traction, < 0 braking (air brake included).
    limit : Array, shape (n,)
        Speed limit of the whole train at every knot [m/s].
    arrivals : tuple of (place, arrival, departure)
        Place of the front and times of every stop [m, s, s], first and last included.
    settings : PlanSettings
        Settings of the plan.
    train : TrainTables
        Force tables of the plan.
    line : Line
        Line of the plan.
    work : Array, shape (3, n - 1)
        Work of traction, of all brakes and of the electric brake between two knots [J], each >= 0.
    places : PlaceLimits, optional
        Limits by place of the plan; None for a line without.
    least : tuple of float
        Least running time of every section between two stops [s]; empty without allowances.
    """

    profile: Profile
    force: Array
    limit: Array
    arrivals: tuple[tuple[float, float, float], ...]
    settings: PlanSettings
    train: TrainTables
    line: Line
    work: Array
    places: PlaceLimits | None = None
    least: tuple[float, ...] = ()

    def _repr_html_(self) -> str:
        rows = (f"<tr><td>{key}</td><td>{value}</td></tr>" for key, value in self.summary().items())
        return f"<p><b>planned in {self.running_time:.1f} s</b></p><table>{''.join(rows)}</table>"

    @property
    def running_time(self) -> float:
        """Time from the first departure to the last arrival [s]."""
        return self.arrivals[-1][1] - self.arrivals[0][2]

    @property
    def front(self) -> Array:
        """Place of the front at every knot [m]."""
        return np.asarray(self.profile.position + self.train.half)

    @property
    def energy(self) -> float:
        """Net energy from the first departure to the last arrival [J]; the traction work with the default settings."""
        traction, _, electric = self.work.sum(axis=1).tolist()
        return weighted_energy(traction, electric, self.running_time, self.settings)

    @property
    def allowances(self) -> tuple[float, ...]:
        """Running time above the least one of every section between two stops [s]; empty without allowances."""
        runs = pairwise(self.arrivals)
        return tuple(b[1] - a[2] - least for (a, b), least in zip(runs, self.least, strict=True)) if self.least else ()

    def summary(self) -> dict[str, Any]:
        """Return the figures of the plan, units in the keys: running_time_s, distance_m, energy_kwh, ..."""
        profile, force = self.profile, self.force
        traction, brake, electric = (self.work.sum(axis=1) / 3.6e6).tolist()
        moving = profile.velocity > 1e-3
        running = force[moving]
        dead = self.places.without_power(self.front, profile.time) if self.places else []
        return {
            "train": self.train.name,
            "line": self.line.name,
            "running_time_s": round(self.running_time, 3),
            "distance_m": round(self.arrivals[-1][0] - self.arrivals[0][0], 3),
            "energy_kwh": round(traction, 4),
            "energy_electric_brake_kwh": round(electric, 4),
            "energy_net_kwh": round(self.energy / 3.6e6, 4),
            "energy_brake_kwh": round(brake, 4),
            "speed_max_kmh": round(3.6 * float(profile.velocity.max()), 3),
            "speed_mean_kmh": round(3.6 * (self.arrivals[-1][0] - self.arrivals[0][0]) / self.running_time, 3),
            "acceleration_max": round(float(profile.acceleration.max()), 4),
            "deceleration_max": round(float(-profile.acceleration.min()), 4),
            "jerk_max": round(float(np.abs(profile.jerk()).max()), 4),
            "traction_max_kn": round(float(max(running.max(initial=0.0), 0.0)) / 1e3, 3),
            "brake_max_kn": round(float(max(-running.min(initial=0.0), 0.0)) / 1e3, 3),
            "force_margin": self.settings.force_margin,
            **({"allowance_s": round(plain_sum(self.allowances), 3)} if self.least else {}),
            **({"without_power": dead} if dead else {}),
            "stops": [
                {
                    "place_m": round(place, 3),
                    "arrival_s": round(arrival, 3),
                    "departure_s": round(departure, 3),
                    **({"post": self.line.post_at(place)} if self.line.chainage else {}),
                    **({"allowance_s": round(self.allowances[k - 1], 3)} if self.least and k else {}),
                }
                for k, (place, arrival, departure) in enumerate(self.arrivals)
            ],
        }


def assemble_plan(
    sections: list[PlanSection],
    strategies: list[DrivingStrategy],
    settings: PlanSettings,
    line: Line,
    period: float,
    *,
    departures: Callable[[int, float], float],
    since: float = 0.0,
) -> Plan:
    """Return the plan of consecutive sections.

    Parameters
    ----------
    sections, strategies
        Sections and the driving strategy of each.
    departures
        Function of section number and previous arrival [s] that returns the departure [s].
    since
        Time of the first knot [s].
    """
    inputs = sections[0].inputs
    start = departures(0, settings.departure or 0.0)
    knots_of: list[tuple[Array, Array]] = []
    arrivals = [(float(sections[0].begin), start, start)]
    for number, (section, strategy) in enumerate(zip(sections, strategies, strict=True)):
        if number:
            start = departures(number, arrivals[-1][1])
            arrivals[-1] = (*arrivals[-1][:2], start)
        fit_jerk_limit(section, start, period, strategy)
        history = section.over_time(section.energy_profile(strategy))
        times, end = section.times(start, period, history)
        knots_of.append((times, section.knots(times, start, history)))
        arrivals.append((float(section.end), float(end), float(end)))
    profile, force = _join_knots(knots_of, arrivals, inputs, period, since)
    limit = inputs.limits.at(profile.position + inputs.train.half, inputs.train.length)
    work = _work_between(profile, force, inputs)
    return Plan(profile, force, limit, tuple(arrivals), settings, inputs.train, line, work, inputs.places)


def _work_between(profile: Profile, force: Array, inputs: SectionInputs) -> Array:
    """Return the work of traction, of all brakes and of the electric brake between two knots [J], shape (3, n - 1).

    The own work of the train is the change of its kinetic energy plus the work against all resistances.  Where the
    force changes its sign, linearly over the step, the work is that of the two triangles with this sum.
    """
    train, speed, front = inputs.train, profile.velocity, profile.position + inputs.train.half
    drag = train.resistance_at(speed)
    if inputs.places is not None:
        drag = drag + inputs.places.tunnel_coefficient(front) * speed**2
    way = np.diff(front)
    own = (
        0.5 * train.inertia * np.diff(speed**2)
        + np.diff(inputs.force.work(front))
        + _means(drag * speed) * profile.period
    )
    first, last = force[:-1], force[1:]
    turned = first * last < 0.0
    share = np.abs(first) / np.maximum(np.abs(first) + np.abs(last), 1e-9)
    least = 0.5 * profile.period * np.where(first > 0.0, share * first, (1.0 - share) * last) * _means(speed)
    traction = np.where(turned, np.maximum(np.maximum(own, least), 0.0), np.maximum(own, 0.0))
    brake = traction - own
    _, electric, _ = train.forces_at(speed)
    braked = np.flatnonzero(force < 0.0)
    if inputs.places is not None and braked.size:
        electric[braked] *= inputs.places.electric_share(front[braked], speed[braked])
    return np.stack((traction, brake, np.minimum(brake, _means(electric) * np.maximum(way, 0.0))))


def _means(values: Array) -> Array:
    """Return the mean of each value and the next one."""
    return np.asarray(0.5 * (values[1:] + values[:-1]))


def _join_knots(
    knots_of: list[tuple[Array, Array]],
    arrivals: list[tuple[float, float, float]],
    inputs: SectionInputs,
    period: float,
    since: float,
) -> tuple[Profile, Array]:
    """Return profile and force [N] of all sections on one time grid, at rest between them."""
    origin = int(np.ceil(since / period - 1e-9))
    count = max(2, knot_count(int(np.ceil(arrivals[-1][1] / period - 1e-9)) + 1 - origin))
    columns = np.zeros((4, count))
    time = period * (origin + np.arange(count))
    passed = np.searchsorted(np.array([arrival for _, arrival, _ in arrivals[1:]]), time + 1e-9, side="right")
    columns[0] = np.array([place for place, _, _ in arrivals])[passed]
    for times, knots in knots_of:
        if times.size:
            first = round(float(times[0]) / period) - origin
            columns[:, first : first + times.size] = knots
    profile = Profile.uniform(period * origin, period, columns[0] - inputs.train.half, columns[1], columns[2])
    return profile, columns[3]
