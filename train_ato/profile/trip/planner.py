"""Trip planner: journey of least cost, run of the whole train along it, profile and applications from this run.

Plans of one train for one set of limits; :mod:`.objective` varies the limits for a weight of the fatigue.

1. A dynamic programming on the reduced model decides traction, electric brake and applications (:mod:`.search`).
2. The nominal train with all vehicles is driven along this journey (:mod:`.driven_run`).
3. The running time of 2 corrects the price of time of 1, until the timetable is kept (:mod:`.running_time`).
4. The averaged speed of the last run is the profile, with brake waves and couplers (:mod:`.run_profile`).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from plant_sim.consist import Consist
from plant_sim.line import Line
from plant_sim.summation import plain_sum
from train_ato.control.air_brake.trip_policy import PlannedApplication
from train_ato.control.force_distribution import SharesAt
from train_ato.profile.planner.line_tables import SpeedLimits
from train_ato.profile.trip.driven_run import TripRun, follow_journey
from train_ato.profile.trip.fatigue import coupler_damage
from train_ato.profile.trip.input_checks import check_final_part, journey_ends, permitted_reductions
from train_ato.profile.trip.journey import QUASI_STATIC, Application, Journey, JourneySearch
from train_ato.profile.trip.plan import JOULES_PER_KWH, TripPlan
from train_ato.profile.trip.reduced_train import nominal_train_model, reduced_train
from train_ato.profile.trip.run_profile import RunProfile
from train_ato.profile.trip.running_time import plan_at_time
from train_ato.profile.trip.settings import TripSettings
from train_ato.profile.trip.unit_displacements import displacements_for_run
from train_ato.profile.trip.unit_shares import shares_for_run

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
        self._check_limits(run)
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

    def at_time(
        self, time: float, report: Callable[[TripPlan], None] = lambda _: None, price: float | None = None
    ) -> TripPlan:
        """Return the plan with a running time [s] (:func:`.running_time.plan_at_time`).

        Parameters
        ----------
        time
            Running time [s].
        report
            Called with every plan of the search.
        price
            First price of time [kWh/s]; default: ``time_weight`` of the settings.
        """
        return plan_at_time(self.at_price, time, self._settings.time_weight if price is None else price, report)
