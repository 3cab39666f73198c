"""Trip planner: journey of least cost, run of the whole train along it, profile and applications from this run.

Plans of one train for one set of limits; :class:`TripSearch` varies the limits for a weight of the fatigue.

1. A dynamic programming on the reduced model decides traction, electric brake and applications (:mod:`.search`).
2. The nominal train with all vehicles is driven along this journey (:mod:`.driven_run`).
3. The running time of 2 corrects the price of time of 1, until the timetable is kept.
4. The averaged speed of the last run is the profile, with brake waves and couplers (:mod:`.run_profile`).

Objective of a trip plan: energy, time and fatigue of the couplers, with the limits of force as free values.

    J = energy + time_weight T + fatigue_weight D    [kWh]

With a given running time the price of time follows from it and replaces ``time_weight``. D is the rainflow damage of
all couplers on the multi-mass train (:func:`.plan.coupler_damage`). The reduced model of the search does not have it. D
depends mostly on the largest traction force and on the rate of the force. For ``fatigue_weight`` > 0 the planner
therefore decreases first the rate and then the traction. It does this step by step at the same price of time, as long
as J decreases. Then it plans again for the running time.
"""

from collections.abc import Callable

import numpy as np

from plant_sim.consist import Consist
from plant_sim.elementary import plain_sum
from plant_sim.line import Line
from plant_sim.section_effects import places_without_power
from train_ato.control.air_brake.trip_policy import PlannedApplication
from train_ato.control.force_distribution import DisplacementAt, SharesAt
from train_ato.control.train_model import TrainModel
from train_ato.profile.driver import nominal_train_model
from train_ato.profile.planner.line_tables import SpeedLimits
from train_ato.profile.profile import Profile
from train_ato.profile.trip.driven_run import SMOOTHING, TripRun, follow_journey, shares_for_run
from train_ato.profile.trip.journey import QUASI_STATIC, Application, Journey, JourneySearch
from train_ato.profile.trip.plan import JOULES_PER_KWH, TripPlan, coupler_damage
from train_ato.profile.trip.reduced_train import reduced_train
from train_ato.profile.trip.run_profile import RunProfile
from train_ato.profile.trip.settings import TripSettings

TIME_TOLERANCE, MAX_DEVIATION = 1e-3, 0.01
"""Relative deviation from the running time that ends the search, and that of a plan of the last round.

The running time is not continuous in the price: an application moves by whole cells."""
MAX_ROUNDS = 7
"""Largest number of journeys for a running time."""
PRICE_RANGE = (0.005, 20.0)
"""Lowest and highest price of time [kWh/s]."""


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


SPACING = 50.0
"""Distance between the places of the displacements [m]: 3 s at 60 km/h; the couplings move with periods above 30 s."""


def displacements_for_run(run: TripRun, profile: Profile, until: float) -> tuple[DisplacementAt, ...]:
    """Return the displacements of the power units against a profile by place; 0 at its end.

    The profile of a train with several power units is the averaged speed of the whole train. The planned force is the
    force of a rigid train along this profile, M a + R(x, v) + shoes. Vehicle 0 and the other power units move by some
    metres against this mean. As a part of the profile, their motion would be multiplied by the mass of the whole train.
    Therefore it is a table of its own (:mod:`train_ato.control.force_distribution`).

    Parameters
    ----------
    run
        Run of the nominal train.
    profile
        Profile made from it.
    until
        Time from which the profile is not that of the run [s].
    """
    inside = run.time <= until
    moved = run.units[inside] - profile.at_times(run.time[inside])[0][:, None]
    position = np.maximum.accumulate(run.position[inside])
    places = np.append(np.arange(position[0], position[-1], SPACING), profile.position[-1])
    table = np.stack([np.interp(places, position, column) for column in moved.T], axis=1).round(3)
    table[-1] = 0.0  # at the stop only the place of vehicle 0 counts, and the forces of the couplers are small
    return tuple(
        DisplacementAt(at=at, displacement=tuple(row))
        for at, row in zip(places.round(1).tolist(), table.tolist(), strict=True)
    )


def journey_ends(line: Line, settings: TripSettings, half: float) -> tuple[float, float]:
    """Return begin and stop of vehicle 0's centre [m]; ValueError if they are not on the line."""
    stops = [stop.at for stop in line.stops]
    end = settings.end if settings.end is not None else (stops[-1] if stops else line.end)
    begin = settings.begin - half if settings.begin is not None else line.begin
    if not line.begin <= begin < end - half - 1000.0 or end > line.end:
        raise ValueError(
            f"begin, end: km {(begin + half) / 1e3:.3f} to km {end / 1e3:.3f}: not 1 km or more on line '{line.name}' "
            f"(km {line.begin / 1e3:.3f} to km {line.end / 1e3:.3f}); correct them"
        )
    return begin, end - half


def check_final_part(model: TrainModel, begin: float, stop: float) -> None:
    """Check that the electric brake of every unit works in the last part of the braking.

    Parameters
    ----------
    model
        Nominal train on its line.
    begin, stop
        Places of vehicle 0's centre at the begin of the last part and at the stop [m].

    Raises
    ------
    ValueError
        With the key of the line and the place of the first section without electric brake.
    """
    line, vehicles, offsets = model.line, model.consist.vehicles, model.consist.offsets
    dead = places_without_power(line, model.consist)
    for unit in model.units:
        fed = model.consist.supplies[unit]
        offset = offsets[fed]
        for number, section in enumerate(line.neutral_sections):
            if section.electric_brake or vehicles[unit].independent_power:
                continue
            first, last = dead[fed][number]
            if first < stop - offset and last > begin - offset:
                raise ValueError(
                    f"line '{line.name}': neutral_sections[{number}]: km {section.begin / 1e3:.3f} to km "
                    f"{section.end / 1e3:.3f}: the train brakes there to its stop, without electric brake; move end"
                )


def permitted_reductions(consist: Consist, settings: TripSettings) -> tuple[float, ...]:
    """Return the reductions of the brake pipe that a plan may use [Pa]; none without an air brake.

    Raises
    ------
    ValueError
        If one is beyond the table of the train.
    """
    brake = consist.air_brake
    if brake is None:
        return ()
    for reduction in settings.air_brake.reductions:
        if not 0.0 < reduction <= brake.reduction[-1]:
            raise ValueError(
                f"air_brake.reductions: {reduction / 1e3:g} kPa: not in the table of train '{consist.name}' (up to "
                f"{brake.reduction[-1] / 1e3:g} kPa); correct it"
            )
    return settings.air_brake.reductions or (brake.reduction[-1],)


ALMOST, BEFORE = 0.99, 60
"""Part of the largest change of the force from which it is the largest one, and samples before a limit with it."""
SHARE_ROUNDS = 2
"""Number of corrections of the shares of the power units; the second one corrects the first by a tenth."""


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
    """

    def __init__(
        self,
        line: Line,
        consist: Consist,
        settings: TripSettings,
        period: float = 0.1,
        quasi_static: float = QUASI_STATIC,
    ) -> None:
        self._settings = settings
        self._half = consist.vehicles[0].length / 2
        self._model = nominal_train_model(consist, line)
        begin, stop = journey_ends(line, settings, self._half)
        self._profile = RunProfile(self._model, settings, stop, period)
        end = stop - self._profile.last_part()
        check_final_part(self._model, end, stop)
        train = reduced_train(self._model, settings, begin, end, permitted_reductions(consist, settings))
        self._search = JourneySearch(train, settings, quasi_static)

    def at_price(self, price: float) -> TripPlan:
        """Return the plan for a price of time [kWh/s]."""
        return self._driven(self._search.journey(price * JOULES_PER_KWH), price)

    def _driven(self, journey: Journey, price: float, shares: tuple[SharesAt, ...] = ()) -> TripPlan:
        """Return the plan from the run of the nominal train along a journey."""
        run = follow_journey(self._model, self._settings, journey, journey.applications, shares)
        self._check_limits(run, journey)
        applications = tuple(self._planned(entry, run) for entry in journey.applications)
        profile, until = self._profile.of(run)
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

    def _check_limits(self, run: TripRun, journey: Journey) -> None:
        """Check that the run of the nominal train keeps the speed limits.

        Parameters
        ----------
        run, journey
            Run along a journey. With a weak brake the journey exceeds the limit, too.

        Raises
        ------
        ValueError
            With the place of the largest excess and its reason.
        """
        settings, limits = self._settings, SpeedLimits(self._model.line, float("inf"))
        excess = run.speed - limits.at(run.position + self._half, self._model.consist.length)
        worst = int(excess.argmax())
        if excess[worst] > 0.0:
            first = worst - int((excess[worst::-1] <= 0.0).argmax())
            if np.interp(run.position[worst], journey.place, journey.speed) > run.speed[worst] - excess[worst]:
                reason = "the permitted brakes are too weak there; permit more brake or reductions"
            elif np.diff(run.force)[max(first - BEFORE, 0) : first + 1].min() <= -ALMOST * settings.slew * run.period:
                reason = f"the brake changes by at most slew_kn_per_s = {settings.slew / 1e3:g}; permit a larger slew"
            else:
                reason = f"a trip averages its forces over {SMOOTHING:g} m; plan without --trip"
            place = f"km {run.position[worst] / 1e3:.2f}"
            raise ValueError(
                f"speed limit exceeded by {3.6 * excess[worst]:.1f} km/h at {place}: {reason}, or increase speed_margin"
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

    def at_time(
        self, time: float, report: Callable[[TripPlan], None] = lambda _: None, price: float | None = None
    ) -> TripPlan:
        """Return the plan with a running time [s]: secant of the logarithms of price and time.

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
        price = self._settings.time_weight if price is None else price
        found: list[tuple[float, TripPlan]] = []
        for _ in range(MAX_ROUNDS):
            plan = self.at_price(price)
            report(plan)
            found.append((price, plan))
            if abs(plan.running_time / time - 1.0) <= TIME_TOLERANCE:
                return plan
            price = _next_price(found, time)
            if not PRICE_RANGE[0] <= price <= PRICE_RANGE[1]:
                break
        best = min((plan for _, plan in found), key=lambda plan: abs(plan.running_time - time))
        if abs(best.running_time / time - 1.0) <= MAX_DEVIATION:
            return best
        raise ValueError(
            f"time: {time:g} s: not possible with these limits, the nearest is {best.running_time:.0f} s; give a time "
            "nearer to it, or permit more traction"
        )


STEPS = (("slew", 0.5, 2), ("traction", 0.8, 3))
"""Limit, factor of a step and largest number of steps, in the order of the search."""
COUPLER_ROUNDS, COUPLER_STEP = 4, 0.85
"""Largest number of searches for the coupler force, and largest factor on it from one to the next."""
Report = Callable[[str], None]


class TripInterrupted(KeyboardInterrupt):
    """Ctrl-C during the search, with the best plan so far.

    Parameters
    ----------
    plan
        Plan nearest to the running time, or of the least cost without one.
    journeys
        Number of plans of the search.
    """

    def __init__(self, plan: TripPlan, journeys: int) -> None:
        super().__init__()
        self.plan, self.journeys = plan, journeys


class TripSearch:
    """Search of the least cost over the limits of force, and over the price of time for a running time.

    Parameters
    ----------
    line, consist
        Line and train.
    settings
        Journey, weights and limits.
    period
        Time between the knots of the profile [s].
    report
        Called with a line of text after every journey of the search.
    """

    def __init__(
        self, line: Line, consist: Consist, settings: TripSettings, period: float, report: Report = lambda _: None
    ) -> None:
        self._line, self._consist, self._settings, self._period = line, consist, settings, period
        self._report = report
        self.plans: list[TripPlan] = []

    def best_plan(self) -> TripPlan:
        """Return the plan of least cost that keeps the running time and the coupler forces."""
        first = self._planned(self._settings, None)
        check_couplers(first)
        if self._settings.fatigue_weight == 0.0:
            return first
        limits = self._decreased_limits(first)
        if limits == self._settings:
            return first
        if self._settings.time is None:
            return min(self.plans, key=lambda plan: plan.cost(first.price))
        try:
            second = self._planned(limits, first.price)
        except ValueError:  # the running time is too short for the decreased limits
            return first
        return min((first, second), key=lambda plan: plan.cost(first.price))

    def interrupted(self) -> TripInterrupted | None:
        """Return the interruption with the best plan so far; None without a plan that keeps the coupler forces."""
        kept = [plan for plan in self.plans if plan.coupler_max <= self._settings.coupler_max]
        if not kept:
            return None
        time = self._settings.time
        if time is None:
            best = min(kept, key=lambda plan: plan.cost(self._settings.time_weight))
        else:
            best = min(kept, key=lambda plan: abs(plan.running_time - time))
        return TripInterrupted(best, len(self.plans))

    def _planned(self, settings: TripSettings, price: float | None) -> TripPlan:
        """Return the plan for some limits: at the weight of time, or with the running time from a first price on.

        The search has no motion between the vehicles. If the run of a train with several power units exceeds the
        coupler force, the search is repeated with a smaller one.
        """
        part = QUASI_STATIC
        for _ in range(COUPLER_ROUNDS):
            planner = TripPlanner(self._line, self._consist, settings, self._period, part)
            if settings.time is not None:
                plan = planner.at_time(settings.time, self._note, price)
            else:
                plan = planner.at_price(settings.time_weight)
                self._note(plan)
            plan = planner.with_unit_shares(plan)
            if plan.coupler_max <= settings.coupler_max or plan.model.n_units < 2:
                break
            part, price = part * min(COUPLER_STEP, settings.coupler_max / plan.coupler_max), plan.price
        return plan

    def _decreased_limits(self, plan: TripPlan) -> TripSettings:
        """Return the settings whose limits have the least cost at the price of time of a plan."""
        price, least, settings = plan.price, plan.cost(plan.price), plan.settings
        for name, factor, steps in STEPS:
            for _ in range(steps):
                trial = settings.model_copy(update={name: factor * getattr(settings, name)})
                try:
                    found = TripPlanner(self._line, self._consist, trial, self._period).at_price(price)
                except ValueError:  # too little traction for the line
                    break
                self._note(found)
                if found.cost(price) >= least:
                    break
                least, settings = found.cost(price), trial
        return settings

    def _note(self, plan: TripPlan) -> None:
        self.plans.append(plan)
        self._report(
            f"journey {len(self.plans)}: {plan.running_time:.0f} s at a price of {plan.price:.3f} kWh/s, "
            f"cost {plan.cost(plan.price):.0f} kWh"
        )


def check_couplers(plan: TripPlan) -> None:
    """Check the coupler forces of a plan; ValueError if one exceeds the limit of the settings."""
    most = plan.settings.coupler_max
    if plan.coupler_max > most:
        raise ValueError(
            f"coupler_max: {most / 1e3:g} kN: the plan has {plan.coupler_max / 1e3:.0f} kN; permit less traction or "
            "brake, or a smaller slew"
        )


def plan_trip(
    line: Line, consist: Consist, settings: TripSettings, period: float = 0.1, report: Report = lambda _: None
) -> TripPlan:
    """Return the trip plan of the settings; the parameters are those of :class:`TripSearch`.

    Raises
    ------
    ValueError
        One line: key, value, problem; fix.
    TripInterrupted
        After Ctrl-C, if there is a plan.
    """
    search = TripSearch(line, consist, settings, period, report)
    try:
        return search.best_plan()
    except KeyboardInterrupt:
        interruption = search.interrupted()
        if interruption is None:
            raise
        raise interruption from None
