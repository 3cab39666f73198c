"""Plan of the total force over a horizon: limits at its nodes, the quadratic programme, and the last plan."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from plant_sim.elementary import libm_exp
from plant_sim.summation import plain_sum
from train_ato.control.algorithms.coupler_limit import CouplerLimit
from train_ato.control.algorithms.horizon_model import HorizonModel, horizon_model, node_times
from train_ato.control.algorithms.limits_ahead import limits_force
from train_ato.control.algorithms.planned_motion import CONTINUED, SOLVED, planned_motion
from train_ato.control.algorithms.predictive_plan import bounds, decide, node_values
from train_ato.control.algorithms.section_limits import limits_at_nodes
from train_ato.control.algorithms.train_constants import drag_slope, force_tables
from train_ato.messages.validity import MAX_FORCE, MAX_POSITION

if TYPE_CHECKING:
    from train_ato.control.contract import LawPlan, Lookahead
    from train_ato.control.train_model import TrainModel
    from train_ato.messages.types import Array

PARTS = 4
"""Steps from node to node of the force that keeps the train on the reference."""
POSITION_BAND = 2.0
"""Position error up to which the largest one has no cost of its own [m]."""
APPROACH = 2.0
"""Double pole with which a speed limit is approached, over the pole of the loop: its gain on the speed error."""
PASSING_TIME = 5.0
"""Time constant with which a passing disturbance decays in the limits ahead [s]."""


@dataclass
class PlanStart:
    """Errors and forces from which a plan begins.

    Attributes
    ----------
    required : Array
        Total force that keeps the train on the reference, at the times of the lookahead [N].
    errors : Array, shape (2, nodes)
        Errors of position [m] and speed [m/s] of the free motion at the nodes.
    disturbance : float
        Acceleration that the force must compensate [m/s²].
    passing : float
        Part of it that does not last [m/s²].
    gained : float
        Error of the acceleration at the time of effect [m/s²].
    rise : float
        Demanded acceleration for z = 0 minus that which acts at the time of effect [m/s²].
    feedforward, last_force : float
        Total feed-forward and total force of the last command [N].
    force_limits : Array, shape (2,)
        Smallest and largest total force at the measured speed [N].
    position_error : float
        Estimated position error [m].
    beyond_reference : float
        Resistance at the measured state beyond that on the reference [N].
    inertia : float
        Estimated inertia [kg].
    air_brake_acts : bool
        True while the air brake acts.
    """

    required: Array
    errors: Array
    disturbance: float
    passing: float
    gained: float
    rise: float
    feedforward: float
    last_force: float
    force_limits: Array
    position_error: float
    beyond_reference: float
    inertia: float
    air_brake_acts: bool


class ForcePlan:
    """Decision about the total force under limits, with a warm start from the last one.

    Parameters
    ----------
    model
        The nominal train.
    period
        Control period [s].
    omega
        Pole of the closed loop [rad/s].
    lookahead, nodes
        Length of the horizon [s] and number of its nodes.
    jerk
        Largest change of the demanded acceleration [m/s³].
    overspeed
        Permitted excess of a speed limit [m/s].
    coupler_limit
        Largest coupler force for a train without waves [N]; 0: no limit.

    Attributes
    ----------
    nodes, times : Array
        Times of the nodes, and those with ``PARTS`` steps between two nodes, after the time of effect [s].
    failures, limited_steps, most_exchanges : int
        Decisions without a solution, those at a limit, and the largest number of exchanges.
    """

    def __init__(
        self, model: TrainModel, period: float, omega: float, lookahead: float, nodes: int, jerk: float,
        overspeed: float, coupler_limit: float,
    ) -> None:  # fmt: skip
        self._model, self._period, self._jerk, self._omega = model, period, jerk, omega
        first = max(period, 0.1 / omega)
        self.nodes = node_times(first, max(lookahead, first * nodes), nodes)
        self.times = np.interp(np.arange(PARTS * (nodes - 1) + 1) / PARTS, np.arange(nodes), self.nodes)
        self._steps = np.concatenate(([0.0 if model.lag else period], np.diff(self.nodes))) + model.lag
        self._models: dict[tuple[float, float, float], list[HorizonModel]] = {}
        self._tables = force_tables(model)
        self._no_tables = np.full_like(self._tables, MAX_FORCE)
        self._couplers = CouplerLimit(model, coupler_limit) if coupler_limit else None
        self._unbounded = np.array([[-np.inf], [np.inf]]).repeat(nodes, axis=1)
        self._limits = np.array([[limit.at, limit.speed] for limit in model.line.restricted_limits]).reshape(-1, 2)
        self._sections = limits_force(model.line)
        self._drag_slope = drag_slope(model)
        half = model.consist.vehicles[0].length / 2.0
        self._ends = np.array([half, half - model.consist.length, overspeed, POSITION_BAND])
        self._band = POSITION_BAND if model.air_brake is None else MAX_POSITION
        self._passed = 1.0 - np.exp(-self.nodes / PASSING_TIME)
        self._memory = math.exp(-period / lookahead)
        self.reset()

    def reset(self) -> None:
        """Forget the last plan and the counts."""
        self._plan = np.zeros(self.nodes.size)
        self._largest = 0.0
        self._active = np.zeros(7 * self.nodes.size, dtype=np.bool_)
        self.failures = self.limited_steps = self.most_exchanges = 0

    def set_delays(self, delays: Array, ticks: int, entries: int, omega: float, share: float) -> None:
        """Set delays and gains of the next plans.

        Parameters
        ----------
        delays : Array, shape (2, units)
            Delays of traction and brake commands [s].
        ticks, entries
            Ticks up to the effect of the last command, and entries of the lookahead before the nodes.
        omega, share
            Pole of the closed loop [rad/s], and gain on the position error over its square.
        """
        self._ticks, self._entries = ticks, entries
        key = (float(delays.max()), omega, share)
        if key not in self._models:
            model, longest = self._model, ticks * self._model.tick
            self._models[key] = [
                horizon_model(self.nodes, delay + 0.5 * self._period, model.share, model.lag, longest, omega, share)
                for delay in delays
            ]
        self._sides = self._models[key]
        self._pole = APPROACH * self._omega
        self._near = int(np.searchsorted(self.nodes, 1.0 / self._pole))

    def decide(self, start: PlanStart, ahead: Lookahead, simulated: bool) -> float:
        """Return the total force for now [N].

        Parameters
        ----------
        start
            Errors and forces now.
        ahead
            Reference and limits ahead.
        simulated
            True for the deviation from a simulated train.
        """
        at_nodes = node_values(start.required[self._entries - 1 :], self.nodes, PARTS)
        at_nodes[0] = start.feedforward
        reference = np.array([ahead.position[self._entries - 1 :: PARTS], ahead.velocity[self._entries - 1 :: PARTS]])
        side = self._sides[int(start.last_force < 0.0)]
        disturbance = start.disturbance - start.passing * self._passed
        allowed = self._bounds(start, ahead, at_nodes, reference, side, simulated, disturbance)
        status = self._solve(start.errors, side, allowed)
        reference[:, 0] = ahead.position[self._ticks], ahead.velocity[self._ticks]
        self._decided = (
            self._ticks * self._model.tick + self.nodes, reference, start.errors, side, self._plan.copy(),
            at_nodes + start.inertia * (self._plan - disturbance),
            allowed[4 * self.nodes.size : 5 * self.nodes.size], status,
        )  # fmt: skip
        return start.feedforward + start.inertia * (float(self._plan[0]) - start.disturbance)

    def planned(self) -> LawPlan:
        """Return the plan of the last decision."""
        return planned_motion(*self._decided)

    def _bounds(
        self, start: PlanStart, ahead: Lookahead, at_nodes: Array, reference: Array, side: HorizonModel,
        simulated: bool, disturbance: Array,
    ) -> Array:  # fmt: skip
        """Return the right-hand sides of the constraints; the force at the nodes receives the running resistance."""
        allowed = np.empty(7 * self.nodes.size)
        drag = (start.beyond_reference, *self._drag_slope)
        # a brake that acts does not last, and the simulated train had these limits
        tables = self._no_tables if simulated and start.air_brake_acts else self._tables
        self._largest = max(abs(start.position_error), self._largest * self._memory)
        self._ends[3] = max(self._band, self._largest)
        bounds(
            at_nodes, reference, self._limits, self._ends, start.force_limits, start.errors,
            (side.response_velocity, self._plan), drag, tables, self._force_range(reference + start.errors, ahead),
            start.inertia, self._jerk, self._steps, disturbance, start.rise, float(start.required[self._ticks]),
            allowed,
        )  # fmt: skip
        if self._model.lag > 0.0:
            self._approach(start, ahead, reference[1], side, allowed)
        return allowed

    def _approach(self, start: PlanStart, ahead: Lookahead, speeds: Array, side: HorizonModel, allowed: Array) -> None:
        """Limit the first decision by an approach of the speed limit with a double pole.

        With the distance m from the limit and its rate m' at the time of effect, the distance is at least
        (m + (m' + pole m) t) e^(-pole t). The decision held up to the node at 1/pole has this speed there. At the nodes
        before it a limit of the speed is a deadbeat control through the lag, which chatters. The motion on the
        reference is always permitted, below the limit.
        """
        n, near = self.nodes.size, self._near
        limits, errors = allowed[4 * n : 5 * n], start.errors[1]
        speed = float(ahead.velocity[self._ticks] + errors[0])
        change = float(ahead.acceleration[self._ticks]) + start.gained
        now, then = float(limits[0] + speeds[0] + errors[0]), float(limits[near] + speeds[near] + errors[near])
        margin = max(min(now, then) - speed, min(now - speed, 0.0))
        time, follow = float(self.nodes[near]), float(errors[0])
        left = libm_exp(-self._pole * time)
        rest = margin + (self._pole * margin - change) * time
        kept = follow + (self._pole * follow + start.gained) * time
        top = then - float(speeds[near])
        permitted = max(top - rest * left, min(top, kept * left)) - float(errors[near])
        held = permitted / plain_sum(side.response_velocity[near].tolist())
        limits[:near] = 1e3
        allowed[0] = min(float(allowed[0]), max(held, -float(allowed[n]), -float(allowed[3 * n])))

    def _solve(self, errors: Array, side: HorizonModel, allowed: Array) -> str:
        """Solve the quadratic programme; without a solution the last plan goes on. Return the status."""
        gradients = (side.gradient_position, side.gradient_velocity)
        exchanges = decide(
            gradients, side.inverse, side.limited, side.dual, side.constraints, errors, allowed, self._active,
            self._plan,
        )  # fmt: skip
        if exchanges < 0:
            self.failures += 1
            self._active[:] = False
            self._plan = np.interp(self.nodes + self._period, self.nodes, self._plan)
            return CONTINUED
        self.most_exchanges = max(self.most_exchanges, exchanges)
        self.limited_steps += bool(self._active.any())
        return SOLVED

    def _force_range(self, motion: Array, ahead: Lookahead) -> Array:
        """Return the range of the total force at the nodes for couplers and sections of the line [N]."""
        within = self._within_couplers(motion)
        if not self._sections or not ahead.force_max.size:
            return within
        return limits_at_nodes(ahead.force_min, ahead.force_max, self.nodes, PARTS, self._ticks, within)

    def _within_couplers(self, motion: Array) -> Array:
        """Return the smallest and largest total force at the nodes for the coupler forces [N], shape (2, nodes).

        The couplers do not limit later brake forces of a train with an air brake, as the envelopes do not.
        """
        if self._couplers is None:
            return self._unbounded
        found = self._couplers.force_range(motion[0], motion[1])
        if self._model.air_brake is not None:
            found[0, 1:] = -np.inf
        return found
