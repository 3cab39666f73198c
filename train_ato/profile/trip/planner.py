"""Trip planner: journey of least cost, run of the whole train along it, profile and applications from this run.

Plans of one train for one set of limits; :mod:`.objective` varies the limits for a weight of the fatigue.

1. A dynamic programming on the reduced model decides traction, electric brake and applications (:mod:`.search`).
2. The nominal train with all vehicles is driven along this journey (:mod:`.driven_run`).
3. The running time of 2 corrects the price of time of 1, until the timetable is kept.
4. The averaged speed of the last run is the profile; it contains the brake waves and the couplers.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from plant_sim.consist import Consist
from plant_sim.line import Line
from plant_sim.summation import plain_sum
from train_ato.control.air_brake.trip_policy import PlannedApplication
from train_ato.control.force_distribution import SharesAt
from train_ato.control.planned_displacement import DisplacementAt
from train_ato.control.train_model import TrainModel
from train_ato.messages.types import Array
from train_ato.profile.driver import average_speed
from train_ato.profile.planner.line_tables import SpeedLimits
from train_ato.profile.profile import Profile
from train_ato.profile.trip.driven_run import AVERAGE, TripRun, follow_journey
from train_ato.profile.trip.fatigue import coupler_damage
from train_ato.profile.trip.final_stop import braking_distance, final_deceleration, stop_knots
from train_ato.profile.trip.input_checks import check_sections, journey_ends, permitted_reductions
from train_ato.profile.trip.journey import QUASI_STATIC, Application, Journey, JourneySearch
from train_ato.profile.trip.reduced_train import nominal_train_model, reduced_train
from train_ato.profile.trip.settings import TripSettings
from train_ato.profile.trip.unit_displacements import displacements_for_run
from train_ato.profile.trip.unit_shares import shares_for_run

JOULES_PER_KWH = 3.6e6
TIME_TOLERANCE, LARGEST_DEVIATION = 1e-3, 0.01
"""Relative deviation from the running time that ends the search, and that of a plan of the last round.

The running time is not continuous in the price: an application moves by whole cells."""
SLACK_AVERAGE = 20.0
"""Window of the average of the motion of vehicle 0 against the mean of the train [s]."""
MAX_ROUNDS = 7
"""Largest number of journeys for a running time."""
SHARE_ROUNDS = 2
"""Number of corrections of the shares of the power units; the second one corrects the first by a tenth."""
LAST_PART = 1.15
"""Reserve of the length of the last part of the braking: the run is a little faster than the journey."""
FINAL_SHARE, ALMOST_AT_REST = 1.1, 0.5
"""Deceleration of the last part over that of the running resistance at a speed [m/s]; the electric brake fades."""
MOST_OF_FINAL = 2.0
"""Largest deceleration of the last part over the planned one; the electric brake is not able to keep a larger one."""
PRICE_RANGE = (0.005, 20.0)
"""Lowest and highest price of time [kWh/s]."""


@dataclass(frozen=True)
class TripPlan:
    """Planned trip of a long train.

    Attributes
    ----------
    profile : Profile
        Speed profile of vehicle 0's centre.
    applications : tuple of PlannedApplication
        Applications of the air brake, with the planned use of the electric brake.
    run : TripRun
        Run of the nominal train, up to the last part of the braking.
    journey : Journey
        Journey of the reduced model.
    price : float
        Price of time [kWh/s].
    model : TrainModel
        Nominal train on its line.
    settings : TripSettings
        Limits of the plan.
    shares : tuple of SharesAt
        Shares of the power units by place; empty for the fixed ones of the model.
    displacements : tuple of DisplacementAt
        Planned motion of several power units against the profile.
    """

    profile: Profile
    applications: tuple[PlannedApplication, ...]
    run: TripRun
    journey: Journey
    price: float
    model: TrainModel
    settings: TripSettings
    shares: tuple[SharesAt, ...] = ()
    displacements: tuple[DisplacementAt, ...] = ()

    @property
    def running_time(self) -> float:
        """Time from the begin to standstill [s]."""
        return self.profile.end - self.profile.start

    @property
    def coupler_max(self) -> float:
        """Largest coupler force of the nominal train, draft or buff [N]."""
        return max(self.run.totals.draft_max, -self.run.totals.buff_max)

    def cost(self, price: float) -> float:
        """Return the objective for a price of time [kWh/s]: net energy, time and fatigue with their weights [kWh]."""
        totals, settings = self.run.totals, self.settings
        energy = (totals.traction - settings.recovered * totals.regenerated) / JOULES_PER_KWH
        damage = float(coupler_damage(self.run.couplers).sum()) if settings.fatigue_weight > 0.0 else 0.0
        return energy + price * self.running_time + settings.fatigue_weight * damage

    def summary(self) -> dict[str, Any]:
        """Return the figures of the plan, units in the keys."""
        totals, damage = self.run.totals, coupler_damage(self.run.couplers)
        return {
            "running_time_s": round(self.running_time, 1),
            "distance_m": round(float(self.profile.position[-1] - self.profile.position[0]), 1),
            "energy_kwh": round(totals.traction / JOULES_PER_KWH, 1),
            "energy_regenerated_kwh": round(totals.regenerated / JOULES_PER_KWH, 1),
            "energy_air_brake_kwh": round(-totals.air_brake / JOULES_PER_KWH, 1),
            "time_price_kwh_per_s": round(self.price, 4),
            "speed_max_kmh": round(3.6 * float(self.profile.velocity.max()), 2),
            "coupler_draft_max_kn": round(totals.draft_max / 1e3, 1),
            "coupler_buff_max_kn": round(totals.buff_max / 1e3, 1),
            "coupler_damage": round(float(damage.sum()), 4),
            "coupler_damage_worst": round(float(damage.max(initial=0.0)), 4),
            "traction_limit": round(self.settings.traction, 3),
            "slew_kn_per_s": round(self.settings.slew / 1e3, 2),
            "applications": [
                {
                    "apply_km": round(entry.apply / 1e3, 3),
                    "release_km": round(entry.release / 1e3, 3),
                    "reduction_kpa": round(entry.reduction / 1e3, 1),
                    "supply": round(searched.supply, 3),
                }
                for entry, searched in zip(self.applications, self.journey.applications, strict=True)
            ],
        }


class TripPlanner:
    """Planner of one train on one line.

    Parameters
    ----------
    line, consist
        Line and train.
    settings
        Journey, weights and limits.
    period
        Time between the knots of the profile [s].
    quasi_static
        Part of the largest coupler force permitted in the search; for a train with several power units.

    Raises
    ------
    ValueError
        One line: key, value, problem; fix.
    """

    def __init__(
        self,
        line: Line,
        consist: Consist,
        settings: TripSettings,
        period: float = 0.1,
        quasi_static: float = QUASI_STATIC,
    ) -> None:
        self._settings, self._period = settings, period
        self._half = consist.vehicles[0].length / 2
        self._model = nominal_train_model(consist, line)
        self._final = settings.final_deceleration or FINAL_SHARE * (
            self._model.running_resistance(ALMOST_AT_REST) / self._model.inertia
        )
        begin, self._stop = journey_ends(line, settings, self._half)
        check_sections(line, begin + self._half - consist.length, self._stop + self._half)
        last = self._last_part()
        train = reduced_train(self._model, settings, begin, self._stop - last, permitted_reductions(consist, settings))
        self._search = JourneySearch(train, settings, quasi_static)

    def _last_part(self) -> float:
        """Return the distance from the end of the journey to the stop [m].

        The profile leaves the run some seconds before the end of the journey, because of the average over time.
        """
        model, settings, speed = self._model, self._settings, self._settings.final_speed
        low, _ = model.limits_of_units([speed] * model.n_units)
        strong = (model.running_resistance(speed) - settings.brake * plain_sum(low)) / model.inertia
        before = speed + strong * 2 * AVERAGE
        way = braking_distance(before, strong, self._final) - AVERAGE * (before + speed)
        return max(LAST_PART * way, speed**2 / (2 * strong))

    def at_price(self, price: float) -> TripPlan:
        """Return the plan for a price of time [kWh/s]."""
        return self._driven(self._search.journey(price * JOULES_PER_KWH), price)

    def _driven(self, journey: Journey, price: float, shares: tuple[SharesAt, ...] = ()) -> TripPlan:
        """Return the plan from the run of the nominal train along a journey."""
        run = follow_journey(self._model, self._settings, journey, journey.applications, shares)
        self._check_limits(run)
        applications = tuple(self._planned(entry, run) for entry in journey.applications)
        profile, until = self._profile(run)
        moved = displacements_for_run(run, profile, until) if self._model.n_units > 1 else ()
        return TripPlan(profile, applications, run, journey, price, self._model, self._settings, shares, moved)

    def with_unit_shares(self, plan: TripPlan) -> TripPlan:
        """Return the plan with the shares of the power units that have the least excess of coupler force and damage."""
        plans = [plan]
        if self._settings.independent_units and self._model.n_units > 1:
            for _ in range(SHARE_ROUNDS):
                shares = shares_for_run(self._model, plans[-1].run, plans[-1].shares)
                try:
                    plans.append(self._driven(plan.journey, plan.price, shares))
                except ValueError:  # another motion of vehicle 0 exceeds a speed limit or misses the stop
                    break
        most = self._settings.coupler_max
        return min(plans, key=lambda p: (max(p.coupler_max - most, 0.0), float(coupler_damage(p.run.couplers).sum())))

    def _check_limits(self, run: TripRun) -> None:
        """Check that the run of the nominal train keeps the speed limits.

        Raises
        ------
        ValueError
            With the place of the largest excess.
        """
        limits = SpeedLimits(self._model.line, float("inf"))
        excess = run.speed - limits.at(run.position + self._half, self._model.consist.length)
        worst = int(excess.argmax())
        if excess[worst] > 0.0:
            raise ValueError(
                f"speed limit exceeded by {3.6 * excess[worst]:.1f} km/h at km {run.position[worst] / 1e3:.2f}: the "
                "permitted brakes are too weak there; permit more brake or reductions, or increase speed_margin"
            )

    def _planned(self, application: Application, run: TripRun) -> PlannedApplication:
        """Return an application with the use of the electric brake at its places."""
        shares = []
        for place in (application.apply, application.release):
            index = min(int(np.searchsorted(run.position, place)), run.position.size - 1)
            low, _ = self._model.limits_of_units([float(run.speed[index])] * self._model.n_units)
            available = -plain_sum(low)
            share = -float(run.force[index]) / available if available > 0.0 else 0.0
            shares.append(round(min(max(share, -1.0), 1.0), 3))
        return PlannedApplication(
            apply=round(application.apply, 1),
            release=round(application.release, 1),
            reduction=application.reduction,
            electric_at_apply=shares[0],
            electric_at_release=shares[1],
        )

    def _profile(self, run: TripRun) -> tuple[Profile, float]:
        """Return the averaged speed of a run, continued to standstill at the stop, and the time of this last part [s].

        The mean speed of the train is averaged over a short time; the motion of vehicle 0 against it, which a force for
        the whole train cannot follow, over a longer one. With several power units the latter is in the displacements.
        """
        time = np.arange(0.0, run.time[-1] + 1e-9, self._period)
        mean = np.interp(time, run.time, run.mean_speed)
        speed = average_speed(mean, self._period, AVERAGE)
        if self._model.n_units < 2:
            slack = np.interp(time, run.time, run.speed) - mean
            speed = speed + average_speed(slack, self._period, SLACK_AVERAGE)
        speed = np.maximum(speed, 0.0)
        speed[0] = 0.0
        acceleration = np.gradient(speed, self._period)
        acceleration[0] = 0.0
        steps = self._period * (speed[1:] + speed[:-1]) / 2 - self._period**2 * np.diff(acceleration) / 12
        position = run.position[0] + np.concatenate(([0.0], np.cumsum(steps)))
        kept = self._cut(position, speed, acceleration)
        rest = stop_knots(
            float(position[kept - 1]), float(speed[kept - 1]), -float(acceleration[kept - 1]), self._stop, self._period
        )
        columns = [np.concatenate((a[:kept], b)) for a, b in zip((position, speed, acceleration), rest, strict=True)]
        # rounded to 1 µm and 1 nm/s: a short file without a loss of accuracy
        rounded = columns[0].round(6), columns[1].round(9), columns[2].round(9)
        return Profile.uniform(0.0, self._period, *rounded), float(time[kept - 1])

    def _cut(self, position: Array, speed: Array, acceleration: Array) -> int:
        """Return the number of knots before the last part; its deceleration is the nearest to that of the settings."""
        last = position.size - round(2 * AVERAGE / self._period)
        first = last - round(60.0 / self._period)
        found = []
        for kept in range(last, first, -round(1.0 / self._period)):
            state = float(speed[kept - 1]), -float(acceleration[kept - 1])
            try:
                needed = final_deceleration(*state, self._stop - float(position[kept - 1]))
            except ValueError:
                continue
            if needed <= MOST_OF_FINAL * self._final:
                found.append((abs(needed - self._final), kept))
        if not found:
            raise ValueError(
                "final_deceleration: the run is too fast or too slow for the stop; permit a stronger brake or a "
                "larger slew, or change final_deceleration"
            )
        return min(found)[1]

    def at_time(
        self, time: float, report: Callable[[TripPlan], None] = lambda _: None, price: float | None = None
    ) -> TripPlan:
        """Return the plan with a running time [s], by the secant of the logarithms of price and time.

        Parameters
        ----------
        time
            Running time [s].
        report
            Called with every plan of the search.
        price
            First price of time [kWh/s]; default: ``time_weight`` of the settings.

        Raises
        ------
        ValueError
            If the time is too short, or so long that the train would stop.
        """
        price, found = self._settings.time_weight if price is None else price, []
        for _ in range(MAX_ROUNDS):
            plan = self.at_price(price)
            error = plan.running_time / time - 1.0
            report(plan)
            found.append((price, plan))
            if abs(error) <= TIME_TOLERANCE:
                return plan
            price = _next_price(found, time)
            if not PRICE_RANGE[0] <= price <= PRICE_RANGE[1]:
                break
        best = min((plan for _, plan in found), key=lambda plan: abs(plan.running_time - time))
        if abs(best.running_time / time - 1.0) <= LARGEST_DEVIATION:
            return best
        raise ValueError(
            f"time: {time:g} s: not possible with these limits, the nearest is {best.running_time:.0f} s; give a time "
            "nearer to it, or permit more traction"
        )


def _next_price(found: list[tuple[float, TripPlan]], time: float) -> float:
    """Return the next price of time [kWh/s] of the search for a running time [s]."""
    ordered = sorted(found, key=lambda row: row[0])
    long = [row for row in ordered if row[1].running_time > time]
    short = [row for row in ordered if row[1].running_time <= time]
    if not short:
        return 3.0 * ordered[-1][0] if len(found) > 1 else _typical(found[0], time)
    if not long:
        return ordered[0][0] / 3.0 if len(found) > 1 else _typical(found[0], time)
    (p0, a), (p1, b) = long[-1], short[0]
    share = np.log(a.running_time / time) / np.log(a.running_time / b.running_time)
    share = float(np.clip(share, 0.1, 0.9))
    return float(p0 * (p1 / p0) ** share)


def _typical(row: tuple[float, TripPlan], time: float) -> float:
    """Return the price for a running time [s] if the price falls with its sixth power."""
    return float(row[0] * np.clip((row[1].running_time / time) ** 6 * 1.1, 0.2, 5.0))
