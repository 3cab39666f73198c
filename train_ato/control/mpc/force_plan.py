"""Plan of the total force: limits at nodes, quadratic programme, last plan; `msgs_docs/mpc_derivation.md`."""
# mypy: allow-untyped-defs

import math

import numpy as np

from plant_sim.compiled import compiled
from plant_sim.elementary import exp_each, libm_exp, matrix_product
from plant_sim.line import SpeedLimit
from plant_sim.record import records_of
from train_ato.control.algorithms.limits_ahead import limits_at_nodes, limits_force
from train_ato.control.algorithms.quadratic_program import inverse
from train_ato.control.algorithms.train_constants import MATCHED_SHARE, drag_slope, force_tables, wave_gain
from train_ato.control.contract import LawPlan, Lookahead
from train_ato.control.mpc import predictive_plan
from train_ato.control.mpc.coupler_limit import CouplerLimit
from train_ato.control.plan_text import PASSES
from train_ato.control.train_model import TrainModel
from train_ato.messages.types import Array
from train_ato.messages.validity import MAX_FORCE, MAX_POSITION

SOFT_FORCE = 1e-6
"""Softness of force and jerk limits, over the diagonal of the dual matrix."""
SOFT_SPEED = 1e-2
"""The same for speed limits, which a disturbance can make impossible to keep."""
SOFT_PEAK = 3e-2
"""The same for the largest position error."""
SOFT_STOP = 1e-2
"""The same for the position error where the reference is at rest."""
PEAK_WEIGHT = 1.0
"""Weight of the square of the largest position error, over that of the same error through the whole horizon."""


def node_times(first: float, last: float, count: int) -> Array:
    """Return ``count`` times from 0 on at geometrically growing distances, the first and the last given [s]."""
    low, high = 1.0, 4.0
    for _ in range(80):
        growth = 0.5 * (low + high)
        total = 0.0
        for _ in range(count - 1):
            total = total * growth + first
        low, high = (growth, high) if total < last else (low, growth)
    times = [0.0]
    step = first
    for _ in range(count - 1):
        times.append(times[-1] + step)
        step *= low
    return np.array(times)


@compiled
def ramp_response(t, lag):
    """Return force, speed and position a time t [s] after the begin of a unit ramp through a lag [s]; 0 before it."""
    if t <= 0.0:
        return 0.0, 0.0, 0.0
    if lag <= 0.0:
        return t, 0.5 * t * t, t * t * t / 6.0
    force = t - lag * (1.0 - libm_exp(-t / lag))
    speed = 0.5 * t * t - lag * force
    return force, speed, t * t * t / 6.0 - lag * speed


def horizon_model(
    nodes: Array, delays: Array, share: Array, lag: float, longest: float, *, omega: float, position_share: float
) -> predictive_plan.HorizonModel:
    """Return the matrices for nodes at times after sending [s].

    ``delays`` [s] and ``share`` are those of the units, ``lag`` is that of the actuators [s]. The errors are weighted
    from the delay ``longest`` on [s], with half of the gain on the speed error, omega [rad/s], and the gain on the
    position error over omega².
    """
    position, velocity = responses(nodes, delays, share, lag, longest)
    steps, weights = np.diff(nodes), np.zeros(nodes.size)  # of the trapezoidal rule [s]
    weights[:-1] += 0.5 * steps
    weights[1:] += 0.5 * steps
    weights[-1] += 1.0 / omega
    weighted_position = (position_share * omega**2) ** 2 * weights[:, None] * position
    weighted_velocity = (4.0 - 2.0 * position_share) * omega**2 * weights[:, None] * velocity
    hessian = matrix_product(np.ascontiguousarray(position.T), weighted_position)
    hessian = hessian + matrix_product(np.ascontiguousarray(velocity.T), weighted_velocity)
    hessian[np.arange(nodes.size), np.arange(nodes.size)] += weights
    inverted = inverse(hessian)
    constraints, softness = constraint_rows(position, velocity, change_rows(nodes, lag)[0])
    limited = matrix_product(inverted, np.ascontiguousarray(constraints.T))
    dual = matrix_product(constraints, limited)
    diagonal = np.diag(dual).copy()
    dual[np.arange(diagonal.size), np.arange(diagonal.size)] += softness * diagonal + 1e-12
    peak = slice(5 * nodes.size, 7 * nodes.size)
    dual[peak, peak] += 1.0 / (PEAK_WEIGHT * (position_share * omega**2) ** 2 * nodes[-1])
    matrices = (weighted_position.T, weighted_velocity.T, position, velocity, inverted, constraints, limited, dual)
    return predictive_plan.HorizonModel(*map(np.asfortranarray, matrices))


@compiled
def responses(nodes, delays, share, lag, longest):
    """Return the errors of position and speed at ``longest + nodes`` for unit decisions, shape (times, nodes)."""
    count = nodes.size
    position, velocity = np.zeros((count, count)), np.zeros((count, count))
    for i in range(delays.size):
        for k in range(count):
            since = nodes[k] + longest - delays[i]
            force, speed, _ = ramp_response(since, lag)
            velocity[k, 0] += share[i] * force
            position[k, 0] += share[i] * speed
            for j in range(count - 1):
                slope = share[i] / (nodes[j + 1] - nodes[j])
                _, speed, place = ramp_response(since - nodes[j], lag)
                _, later_speed, later_place = ramp_response(since - nodes[j + 1], lag)
                velocity[k, j] -= slope * (speed - later_speed)
                velocity[k, j + 1] += slope * (speed - later_speed)
                position[k, j] -= slope * (place - later_place)
                position[k, j + 1] += slope * (place - later_place)
    return position, velocity


def change_rows(nodes: Array, lag: float) -> tuple[Array, Array]:
    """Return the rows of the change of the acceleration since the former node, shape (nodes, nodes).

    Through a lag the acceleration changes at the rate w over the lag, where w is the demand less the acceleration. A
    row is this rate times the time since the former node. The second result, shape (nodes,), is the part of an
    acceleration at the first node that it subtracts. Without a lag a row is the change of the demand.
    """
    rows, part = np.eye(nodes.size), np.zeros(nodes.size)
    beyond, kept = rows[0].copy(), 1.0
    for j, width in enumerate(np.diff(nodes).tolist(), 1):
        rows[j, j - 1] = -1.0
        if lag:
            decay = libm_exp(-width / lag)
            beyond = decay * beyond + rows[j] * ((1.0 - decay) * lag / width)
            kept *= decay
            rows[j], part[j] = beyond * (width / lag), kept * width / lag
    return rows, part


def constraint_rows(position: Array, velocity: Array, change: Array) -> tuple[Array, Array]:
    """Return the rows A of the constraints for the responses of position and speed, and their softness.

    The rows are upper and lower force limits, jerk limits, speed limits, position error, and stops.
    """
    count = velocity.shape[0]
    unit = np.eye(count)
    rows = np.vstack((unit, -unit, change, -change, velocity, position, -position, position))
    softness = np.repeat([SOFT_FORCE, SOFT_SPEED, SOFT_PEAK, SOFT_STOP], [4 * count, count, 2 * count, count])
    return rows, softness


SOLVED, CONTINUED = "solved", "iterations"
"""Status of a new plan, and of the last one after too many exchanges."""
KEPT = 0.5
"""Distance beyond a stop up to which a plan counts as one that keeps it [m]; 100 s ahead right plans have .3 m."""
PARTS = 4
"""Steps from node to node of the force that keeps the train on the reference."""
POSITION_BAND = 2.0
"""Position error up to which the largest one has no cost of its own [m]."""
STOP_ROOM = 0.3
"""Planned position error where the reference is at rest from which on the train brakes earlier [m]."""
STOP_GAIN = 3.0
"""Gain on the speed of a constraint of a stop, times the time left: it is below that of the waves of the couplers."""
APPROACH = 2.0
"""Double pole with which a speed limit is approached, over the pole of the loop: its gain on the speed error."""
PASSING_TIME = 5.0
"""Time constant with which a passing disturbance decays in the limits ahead [s]."""


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
    constants : PlanConstants
        Constants of all plans.
    nodes, times : Array
        Times of the nodes, and those with ``PARTS`` steps between two nodes, after the time of effect [s].
    failures, limited_steps, most_exchanges : int
        Decisions without a solution, those at a limit, and the largest number of exchanges.
    """

    def __init__(
        self, model: TrainModel, period: float, *, omega: float, lookahead: float, nodes: int, jerk: float,
        overspeed: float, coupler_limit: float,
    ) -> None:  # fmt: skip
        self._model, self._period = model, period
        first = max(period, 0.1 / omega)
        self.nodes = node_times(first, max(lookahead, first * nodes), nodes)
        self.times = np.interp(np.arange(PARTS * (nodes - 1) + 1) / PARTS, np.arange(nodes), self.nodes)
        self._models: dict[tuple[float, float, float], list[predictive_plan.HorizonModel]] = {}
        self._tables = force_tables(model)
        self._no_tables = np.full_like(self._tables, MAX_FORCE)
        self._couplers = CouplerLimit(model, coupler_limit) if coupler_limit else None
        self._unbounded = np.array([[-np.inf], [np.inf]]).repeat(nodes, axis=1)
        self._sections = limits_force(model.line)
        half = model.consist.vehicles[0].length / 2.0
        self._band = POSITION_BAND if model.air_brake is None else MAX_POSITION
        stops = model.air_brake is None and not model.reversing
        self._stop_time = STOP_GAIN / wave_gain(model, MATCHED_SHARE) if stops else math.inf
        steps, kept = np.append(model.lag or period, np.diff(self.nodes)), change_rows(self.nodes, model.lag)[1]
        pole, (slope, curvature) = APPROACH * omega, drag_slope(model)
        self.constants = predictive_plan.PlanConstants(
            self.nodes, steps, kept, passed=1.0 - exp_each(-self.nodes / PASSING_TIME), parts=PARTS,
            near=int(np.searchsorted(self.nodes[:-1], 1.0 / pole)), period=period, jerk=jerk, pole=pole,
            lag=model.lag, stop_time=self._stop_time, stop_room=STOP_ROOM, drag_slope=slope,
            drag_curvature=curvature, front=half, rear=half - model.consist.length, overspeed=overspeed,
            limits=records_of(SpeedLimit, model.line.restricted_limits),
        )  # fmt: skip
        self.allowed = np.empty((predictive_plan.CONSTRAINTS, nodes))
        self.reset()

    def reset(self) -> None:
        """Forget the last plan and the counts."""
        self._plan = np.zeros(self.nodes.size)
        self._active = np.zeros(self.allowed.size, dtype=np.bool_)
        self.failures = self.limited_steps = self.most_exchanges = 0

    def set_delays(self, delays: Array, ticks: int, entries: int, omega: float, share: float) -> None:
        """Set delays, shape (2, units), of traction and brake commands [s] and gains of the next plans.

        ``ticks`` pass up to the effect of the last command, and ``entries`` of the lookahead are before the nodes.
        ``omega`` is the pole of the closed loop [rad/s], ``share`` the gain on the position error over its square.
        """
        self._ticks, self._entries = ticks, entries
        key = (float(delays.max()), omega, share)
        if key not in self._models:
            model, longest = self._model, ticks * self._model.tick
            solved = {"omega": omega, "position_share": share}
            self._models[key] = [
                horizon_model(self.nodes, delay + 0.5 * self._period, model.share, model.lag, longest, **solved)
                for delay in delays
            ]
        self._sides = self._models[key]

    def decide(self, start: predictive_plan.PlanStart, ahead: Lookahead, *, simulated: bool) -> float:
        """Return the total force for now [N]; ``simulated`` for the deviation from a simulated train."""
        effect, first = self._ticks, self._entries - 1
        nodes = predictive_plan.NodeMotion(ahead.position[first::PARTS].copy(), ahead.velocity[first::PARTS].copy())
        reference = predictive_plan.PlanReference(
            nodes, start.required[first:], ahead.position.item(effect), ahead.velocity.item(effect),
            ahead.acceleration.item(effect), start.required.item(effect),
        )  # fmt: skip
        brake, traction = self._tables if start.gain == 1.0 else start.gain * self._tables
        if simulated and start.air_brake_acts:
            brake, traction = self._no_tables  # a brake that acts does not last, and the simulated train had its limits
        low, high = self._force_range(nodes, start.motion, ahead)
        limits = predictive_plan.ForceAhead(brake, traction, low, high, max(self._band, abs(start.position_error)))
        found = predictive_plan.PlannedNodes(*np.empty((5, self.nodes.size)))
        exchanges, limited, at_brake_limit = predictive_plan.direct_plan_step()(
            self._sides[int(start.last_force < 0.0)], self.constants, start, limits, reference, self.allowed,
            self._active, self._plan, found,
        )  # fmt: skip
        self.failures += exchanges < 0
        self.most_exchanges = max(self.most_exchanges, exchanges)
        self.limited_steps += limited
        status = SOLVED if exchanges >= 0 else CONTINUED
        self._decided = effect * self._model.tick + self.nodes, nodes, found, status, at_brake_limit
        return start.feedforward + start.inertia * (self._plan.item(0) - start.disturbance)

    def planned(self) -> LawPlan:
        """Return the plan of the last decision."""
        times, reference, plan, status, at_brake_limit = self._decided
        if at_brake_limit and self._stop_time < math.inf and reference.velocity[0] != 0.0:
            beyond = (plan.position - reference.position)[reference.velocity == 0.0].max(initial=0.0)
            if beyond > KEPT:
                status = f"{status}, {PASSES} {beyond:.1f} m"  # only then the force is the reason
        return LawPlan(times, plan.position, plan.velocity, plan.force, plan.excess, status)

    def _force_range(
        self, reference: predictive_plan.NodeMotion, motion: predictive_plan.RelativeMotion, ahead: Lookahead
    ) -> Array:
        """Return the range of the total force at the nodes for couplers and sections of the line [N]."""
        within = self._unbounded
        if self._couplers is not None:
            errors: predictive_plan.NodeMotion = predictive_plan.free_errors(motion, self.nodes, self._model.lag)
            within = self._couplers.force_range(
                reference.position + errors.position, reference.velocity + errors.velocity
            )
            if self._model.air_brake is not None:
                within[0, 1:] = -np.inf  # as the envelopes, the couplers do not limit its later brake forces
        if not self._sections or not ahead.force_max.size:
            return within
        return limits_at_nodes(
            ahead.force_min, ahead.force_max, self.nodes, parts=PARTS, effect=self._ticks, limits=within
        )
