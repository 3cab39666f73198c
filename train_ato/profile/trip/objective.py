"""Objective of a trip plan: energy, time and fatigue of the couplers, with the limits of force as free values.

    J = energy + time_weight T + fatigue_weight D    [kWh]

With a given running time the price of time in place of ``time_weight`` follows from it. D is the rainflow damage of all
couplers on the multi-mass train (:mod:`.fatigue`), which the reduced model of the search does not have. It depends
mostly on the largest traction force and on the rate of the force. For ``fatigue_weight`` > 0 the planner therefore
decreases first the rate, then the traction, step by step at the same price of time, as long as J decreases, and plans
again for the running time.
"""

from __future__ import annotations

from collections.abc import Callable

from plant_sim.consist import Consist
from plant_sim.line import Line
from train_ato.profile.trip.journey import QUASI_STATIC
from train_ato.profile.trip.plan import TripPlan
from train_ato.profile.trip.planner import TripPlanner
from train_ato.profile.trip.settings import TripSettings

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
        """Return the plan of least cost that keeps the running time and the coupler forces.

        Raises
        ------
        ValueError
            One line: key, value, problem; fix.
        """
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
    """Check the coupler forces of a plan.

    Raises
    ------
    ValueError
        If one exceeds the limit of the settings.
    """
    most = plan.settings.coupler_max
    if plan.coupler_max > most:
        raise ValueError(
            f"coupler_max: {most / 1e3:g} kN: the plan has {plan.coupler_max / 1e3:.0f} kN; permit less traction or "
            "brake, or a smaller slew"
        )


def plan_trip(
    line: Line, consist: Consist, settings: TripSettings, period: float = 0.1, report: Report = lambda _: None
) -> TripPlan:
    """Return the trip plan of the settings.

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
