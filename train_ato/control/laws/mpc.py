"""Constrained model predictive control of the train as one mass, with exact delays and a look-ahead of 120 s (ours).

The law predicts the errors of position and speed over the delay from the measured forces and the commands in flight,
unit by unit, and plans the force over the next two minutes under its limits. A force limit ahead is met early.

**Motion over the delay.** With the total force F, the force R that keeps the train on the reference and the
disturbance d::

    e_p' = e_v,   e_v' = (F - R)/M + d,   R = M v_d' + W(x_d, v_d)
    F_i' = (g u_i(t - c tau_i) - F_i)/Ta

F_i begins at the measured force; u_i are the commands in flight, each with the delay of its sign.

**Plan.** The command is u_i = share_i [R + Ta R' + M (z - d)]/g with R at the time of effect plus half of a control
period (the command is held). z(s) is linear between 32 nodes s_j at geometrically growing distances. Responses of e_p
and e_v to z through delay and lag are closed forms (`horizon_model.py`)::

    J = sum_k W_k [(a omega²)² e_p² + (4 - 2a) omega² e_v²] + sum_j w_j z_j² + T (a omega²)² b²

Without constraints this is z = -2 omega e_v - a omega² e_p on the state at the time of effect: the gain k_v of the
linear-quadratic regulator of a double integrator is sqrt(q_v + 2 sqrt(q_p)). Default omega = .9/(tau + Ta), at most
1.5; for hauled vehicles at most a third of the wave impedance sqrt(k m) of the couplers over the mass of the train.

**Constraints**, all soft, so that the programme always has a solution: force of the envelopes at the speed of the last
plan at every node, with the running resistance of that speed; |jerk| of the train at most ``jerk``; speed at most the
limit of the line over the whole train plus ``overspeed``; coupler forces; |e_p| at most B + b, with the length T
of the horizon and B = 2 m or, if that is more, the largest |e_p| of about the last T. An error that a force limit
makes unavoidable is divided over the horizon in this way. R between the nodes has its part in the
limits: the nodes have the nearest function that is linear between them. With an air brake there is no B, and the brake
force ahead has no limit: its later applications are not in the input of the law. On a line with neutral sections,
power limits or adhesion sections the force of the units there is a limit as well (`section_limits.py`): the train gains
speed before a neutral section. Other units take over the force that a unit in it cannot give.

The dual is a linear complementarity problem with a constant matrix, solved by block principal pivoting from the last
active rows and, if that makes no progress, one row at a time (`quadratic_program.py`), at most 200 exchanges. If they
are not enough, the last plan goes on; diagnostics count it.

**Couplers.** With the share s_j of the force, the part mu_j of the mass and the resistance W_j in front of coupler j,
the train without waves has the force C_j = (s_j - mu_j) F - (W_j - mu_j W) in it, > 0 draft. |C_j| at most
``coupler_limit`` for all couplers is a range of F at every node, by grade and speed there (`coupler_limit.py`). Waves
add to C_j; the shoe force and the disturbance count as proportional to the mass.

**Disturbance and mass.** Kalman filters of e_p, e_v, d, weighted by likelihood, and one of the error theta of the
mass, with measured noise from ``speed_noise`` on (`motion_observer.py`): offset-free. With couplers there are three,
with bandwidths of ``observer_ratio`` omega and its fourth and sixteenth part. Without couplers there is one for a
gust, and one for a steady rate of d, as of a grade under a train of some length: d at the time of effect is d + T_r r
(1 - e^(-s/T_r)), and the command gives d + Ta d' there (`disturbance_filters.py`). M/(1 + k theta) replaces M, with k
= 1 - P/P_0 from the variance P of theta.

**Arrival and departure** (`standstill_force.py`). The holding brake acts below its speed without traction only. A train
within .1 m of a reference at rest has no traction, and departs with the reference; on a rise its force then reaches
that of the grade as fast as the limits permit. The last brake force decays before the holding brake acts. With hauled
vehicles there is no traction from a reference speed of .05 m/s down to the stop: the vehicles stop one by one.

**Units on soft couplers.** If every vehicle is driven and pi/T_w < 3 omega, with the time T_w of a wave through the
couplers, a Kalman filter estimates the deviations of the units from the mean, and a linear-quadratic regulator on their
state after the delay adds forces with the sum 0 (`unit_deviations.py`). The observer ratio is then 2.5: disturbances
that excite the couplers change within the delay.

**Simulated train.** Under `twin` a train with hauled vehicles has the force F_c of the simulated train in place of R up
to the effect of the last command, and the feed-forward of `twin` (`simulated_reference.py`). The plan is that of the
deviation, e_v' = (F - F_c - W(v) + W(v_d))/M, with a = 2 and no estimate of a disturbance: ``identify`` of `twin` finds
the errors of mass, running resistance and air brake, and the position error is the integral for the rest. The later
nodes have no force limit while the air brake acts: its present force does not last.

**Identification.** A bank of 17 factors c on the delays, .4 to 2, each with the gain g by least squares, bounded to
.5 to 1.5, from measured force and commands (`actuator_identification.py`). If no candidate explains the force to 5 %,
diagnostics has ``actuator_model: wrong``. Braking below 1 m/s does not count: the holding brake gives that force.
**Safe gains:** from a misfit of 15 % until one below 5 % the plan has ``safe_share`` of omega, and the units have no
regulator. With ``identify`` false the model itself is tested in this way.

Limits: the air brake is only a known force. With hauled vehicles theta is 0. Where other laws are better: the stop of
one locomotive with 105 wagons without `twin` (`pid`). A reference with steps of the speed
(`freight_consensus` without `realistic`) is not tracked. Goals, misses and other solvers: `msgs_docs/mpc_goals.md`,
made with `python bench/mpc.py`, `python bench/mpc_solvers.py` and, for soft couplers, `python bench/freight_front.py`.

Needs: any train; delay, lag and envelopes of the model, the measured force, and the reference ahead. The law predicts
over the delay and has its own feed-forward: use compensation `none` or `preview`, with hauled vehicles `twin`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from plant_sim.summation import plain_sum
from train_ato.control.algorithms.actuator_identification import ActuatorIdentification
from train_ato.control.algorithms.coupler_limit import CouplerLimit
from train_ato.control.algorithms.disturbance_filters import motion_by_rate
from train_ato.control.algorithms.force_shares import mean_over_units
from train_ato.control.algorithms.guard import GuardedLaw
from train_ato.control.algorithms.horizon_model import HorizonModel, horizon_model, node_times
from train_ato.control.algorithms.limits_ahead import limits_force
from train_ato.control.algorithms.motion_observer import SPEED_PRIOR, MotionObserver
from train_ato.control.algorithms.planned_motion import CONTINUED, SOLVED, planned_motion
from train_ato.control.algorithms.predictive_plan import bounds, decide, free_errors, free_motion, node_values
from train_ato.control.algorithms.section_limits import limits_at_nodes, within_units
from train_ato.control.algorithms.simulated_reference import SIMULATED_SHARE, SIMULATED_WAVES, follow_simulation
from train_ato.control.algorithms.standstill_force import StandstillForce
from train_ato.control.algorithms.train_constants import default_omega, drag_slope, force_tables, wave_time
from train_ato.control.algorithms.unit_deviations import UnitDeviations
from train_ato.control.contract import LawInput, LawPlan, Lookahead, parameter
from train_ato.control.observers.force_balance import lag_weight
from train_ato.control.train_model import STANDSTILL_SPEED
from train_ato.messages.types import Array
from train_ato.messages.validity import MAX_FORCE, MAX_POSITION

if TYPE_CHECKING:
    from train_ato.control.train_model import TrainModel

IDENTIFICATION_SPEED = 1.0
"""Speed below which the electric brake fades and the commands do not explain the force [m/s]."""
PARTS = 4
"""Steps from node to node of the force that keeps the train on the reference."""
POSITION_BAND = 2.0
"""Position error up to which the largest one has no cost of its own [m]."""
SOFT_COUPLERS = 3.0
"""Frequency pi/T_w of the slowest wave in the couplers over omega, below which the units have a regulator."""
SOFT_RATIO = 2.5
"""Bandwidth of the observer over omega for units on soft couplers: the mean of disturbances that excite the couplers
changes within the delay, and a fast estimate of it has the wrong phase at the time of effect."""
FREE_RATIO = 6.0
"""The same for a train without couplers: a gust is in the estimate within the delay, and the waves of couplers, which a
fast estimate follows, do not exist."""


@dataclass(frozen=True)
class MpcParameters:
    """Parameters of :class:`Mpc`."""

    omega: float = parameter(
        0.0, "rad/s", 0.0, 10.0, "half of the gain on the speed error; 0: from delay, lag and couplers"
    )
    observer_ratio: float = parameter(
        0.0, "1", 0.0, 100.0, "bandwidth of the observer over omega; 0: 5, one vehicle 6, soft couplers 2.5, hauled .3"
    )
    lookahead: float = parameter(120.0, "s", 1.0, 600.0, "length of the horizon")
    nodes: int = parameter(32, "1", 4, 60, "nodes of the decision over the horizon")
    jerk: float = parameter(1.0, "m/s³", 0.01, 1e6, "largest change of the demanded acceleration")
    overspeed: float = parameter(0.1, "m/s", 0.0, 10.0, "permitted excess of a speed limit")
    identify: bool = parameter(True, "", 0, 1, "estimate gain and delay of the actuators")
    coupler_limit: float = parameter(
        0.0, "N", 0.0, 1e8, "largest coupler force of the plan for a train without waves; 0: no limit"
    )
    safe_share: float = parameter(0.3, "1", 0.05, 1.0, "part of omega while the model of the actuators is not safe")
    speed_noise: float = parameter(
        SPEED_PRIOR, "m/s", 0.0, 1.0, "standard deviation of the measured speed at which its estimate begins"
    )
    position_share: float = parameter(0.5, "1", 0.01, 1.0, "a, gain on the position error over omega²")


class Mpc(GuardedLaw):
    """Constrained model predictive control with exact delays and a long look-ahead (ours)."""

    Parameters: ClassVar[type] = MpcParameters
    uses_feedforward = False
    predicts_delay = True

    def __init__(self, parameters: MpcParameters, model: TrainModel, period: float) -> None:
        super().__init__(parameters, model, period)
        p = parameters
        self._hauls = self.follows_simulation = len(model.consist.vehicles) > model.n_units
        self.omega = p.omega or default_omega(model)
        first = max(period, 0.1 / self.omega)
        self._nodes = node_times(first, max(p.lookahead, first * p.nodes), p.nodes)
        self._times = np.interp(np.arange(PARTS * (p.nodes - 1) + 1) / PARTS, np.arange(p.nodes), self._nodes)
        self._steps = np.concatenate(([0.0 if model.lag else period], np.diff(self._nodes))) + model.lag
        self._identification = ActuatorIdentification(model, period, p.identify)
        self._models: dict[tuple[float, float, float], list[HorizonModel]] = {}
        soft = model.n_units > 1 and math.pi < SOFT_COUPLERS * self.omega * wave_time(model)
        self._deviations = UnitDeviations.of(model, period, lag_weight(period, model.lag)) if soft else None
        free = len(model.consist.vehicles) == 1
        ratio = 0.3 if self._hauls else SOFT_RATIO if self._deviations else FREE_RATIO if free else 5.0
        bandwidth = (p.observer_ratio or ratio) * self.omega
        waves = wave_time(model) if self._hauls else 0.0
        self._new_observer = partial(MotionObserver, period, bandwidth, waves, not free, p.speed_noise)
        self._observer = self._new_observer()
        self._weight = lag_weight(period, model.lag)
        self._tables = force_tables(model)
        self._standstill = StandstillForce(model, period)
        self._no_tables = np.full_like(self._tables, MAX_FORCE)
        self._couplers = CouplerLimit(model, p.coupler_limit) if p.coupler_limit else None
        self._unbounded = np.array([[-np.inf], [np.inf]]).repeat(p.nodes, axis=1)
        self._limits = np.array([[limit.at, limit.speed] for limit in model.line.restricted_limits]).reshape(-1, 2)
        self._sections = limits_force(model.line)
        self._drag_slope = drag_slope(model)
        half = model.consist.vehicles[0].length / 2.0
        self._ends = np.array([half, half - model.consist.length, p.overspeed, POSITION_BAND])
        self._band = POSITION_BAND if model.air_brake is None else MAX_POSITION
        self._memory = math.exp(-period / p.lookahead)
        self.clear_state()

    def _set_delays(self, factor: float) -> None:
        """Take the delays of the model times a factor: prediction, matrices and times of the lookahead."""
        model, p = self.model, self.parameters
        self._actuators = np.array([factor * model.delay, factor * model.delay_brake, model.share])
        self._ticks = math.ceil(float(self._actuators[:2].max()) / model.tick - 1e-9)
        self._entries = self._ticks + 2 + math.ceil(0.5 * self.period / model.tick)
        longest = self._ticks * model.tick
        self.lookahead_times: Array = np.concatenate((model.tick * np.arange(self._entries), longest + self._times[1:]))
        omega = self.omega * (p.safe_share if self._cautious else 1.0)
        share = SIMULATED_SHARE if self._simulated else p.position_share
        if (factor, omega, share) not in self._models:
            self._models[factor, omega, share] = [
                horizon_model(
                    self._nodes, delay + 0.5 * self.period, model.share, model.lag, longest, omega, share
                )
                for delay in self._actuators[:2]
            ]  # fmt: skip
        self._sides = self._models[factor, omega, share]

    def clear_state(self) -> None:
        """Clear observer, identification, plan and counts."""
        self._observer = self._new_observer()
        self._identification.reset()
        self._standstill.reset()
        if self._deviations is not None:
            self._deviations.reset()
        self._before: tuple[float, float, float] | None = None
        self._plan = np.zeros(self._nodes.size)
        self._largest = 0.0
        self._active = np.zeros(7 * self._nodes.size, dtype=np.bool_)
        self._failures = self._limited_steps = self._most_exchanges = self._cautious_steps = 0
        self._cautious = self._simulated = False
        self._set_delays(1.0)

    def on_missed_sample(self) -> None:
        """Handle a missed sample: the observer restarts at the next one with the present disturbance."""
        self._observer.miss()
        self._before = None
        if self._deviations is not None:
            self._deviations.reset()

    def diagnostics(self) -> dict[str, str]:
        """Return the counts of the solver and the disturbance as text."""
        return {
            "limited_steps": str(self._limited_steps),
            "most_exchanges": str(self._most_exchanges),
            "solver_failures": str(self._failures),
            "disturbance": repr(self._observer.disturbance),
            "delay_factor": repr(self._identification.factor),
            "actuator_gain": repr(self._identification.gain),
            "actuator_model": "wrong" if self._identification.model_is_wrong else "right",
            "cautious_steps": str(self._cautious_steps),
            "mass_error": repr(self._observer.mass_error),
            "speed_noise": repr(self._observer.speed_noise),
        }

    def demand(self, inputs: LawInput) -> list[float]:
        """Return the force demand of every unit [N]."""
        if inputs.lookahead.simulated_force.size and not self._simulated:
            self._begin_simulated()
        changed = self._identify(inputs)
        wanted = self._wanted(inputs)
        self._cautious_steps += self._cautious
        if changed or self._cautious != self._identification.model_is_unsafe:
            self._cautious = self._identification.model_is_unsafe
            self._set_delays(self._identification.factor)
        return wanted

    def _begin_simulated(self) -> None:
        """Plan the deviation from a simulated train from now on."""
        self._simulated = True
        self._observer.set_simulated(SIMULATED_WAVES)
        self._set_delays(self._identification.factor)

    def _identify(self, inputs: LawInput) -> bool:
        """Compare the measured force with the commands; return True for a new delay, for the next step on."""
        in_flight = inputs.commands_in_flight
        last = in_flight[-1] if in_flight.size else np.array(self._last_force)
        pulls = float(self._identification.sent.min()) >= 0.0
        moves = pulls or abs(self.mean(inputs.velocity.tolist())) > self._rest_speed(IDENTIFICATION_SPEED)
        return self._identification.step(last, mean_over_units([1.0] * self.n, inputs.applied.tolist()), moves)

    def _stands(self, speed: float, reference: float) -> bool:
        """Return True at standstill by measured and estimated speed [m/s]."""
        estimated = speed if self._observer.stands else reference + self._observer.speed_error
        return abs(speed) < self._rest_speed(STANDSTILL_SPEED) and abs(estimated) < STANDSTILL_SPEED + 3.0 * (
            self._observer.speed_noise if self._observer.stands else 0.0
        )

    def _rest_speed(self, smallest: float) -> float:
        """Return the measured speed below which the train can be at standstill [m/s]."""
        return smallest + 3.0 * self._observer.speed_noise

    def _wanted(self, inputs: LawInput) -> list[float]:
        """Return the force of the plan for every unit [N]."""
        model, ahead = self.model, inputs.lookahead
        resisting = self._observe(inputs)
        inertia = self._inertia = model.inertia / (1.0 + self._mass_error())
        count, simulated = self._ticks + 1, ahead.simulated_force
        required = follow_simulation(inertia * ahead.acceleration + ahead.resistance, simulated, count)
        feedforward = inputs.feedforward.tolist() if simulated.size else self._feedforward(required)
        self._beyond_reference = resisting - float(simulated[0] if simulated.size else ahead.resistance[0])
        disturbance = self._unexplained - self._beyond_reference / inertia
        motion = np.array([self._observer.position_error, self._observer.speed_error, disturbance, 0.0])
        gain = self._gain()
        sent = self._identification.sent if self.parameters.identify else inputs.commands_in_flight
        free_motion(
            motion, inputs.applied, gain * sent, required[:count], self._actuators, model.tick, model.lag, inertia,
        )  # fmt: skip
        disturbance = self._add_rate(motion)
        errors = np.empty((2, self._nodes.size))
        free_errors(motion, self._nodes, model.lag, errors[0], errors[1])
        rise = (plain_sum(feedforward) - required[count - 1]) / inertia - motion[3]
        if model.lag == 0.0:
            rise = (plain_sum(feedforward) - gain * plain_sum(self._last_force)) / inertia - disturbance
        total = self._decide(inputs, required, errors, disturbance, rise, plain_sum(feedforward))
        added = total - plain_sum(feedforward)
        wanted = [force + added * share for force, share in zip(feedforward, self.share, strict=True)]
        if self._deviations is not None:
            between = self._deviations.forces(inputs, gain * sent, self._actuators, self._ticks)
            if not self._cautious:
                wanted = [force + more for force, more in zip(wanted, between, strict=True)]
        effect, later = self._ticks, self._entries - 1 + PARTS
        places = float(ahead.velocity[effect]), float(ahead.acceleration[effect]), float(ahead.velocity[later])
        force = float(required[effect] + inertia * (motion[3] - disturbance))
        wanted = self._standstill.limited(wanted, motion, places, self._observer.stands, inertia, force)
        if self._sections and ahead.force_max.size:
            wanted = within_units(
                wanted, self.share, ahead.force_min[effect].tolist(), ahead.force_max[effect].tolist()
            )
        return [force / gain for force in wanted]

    def _add_rate(self, motion: Array) -> float:
        """Add the rate of the disturbance to the motion at the time of effect; return d + Ta d' there [m/s²]."""
        rate, longest = self._observer.disturbance_rate, self._ticks * self.model.tick
        position, speed, risen, _ = motion_by_rate(rate, longest)
        motion += position, speed, 0.0, risen
        _, _, risen, rate = motion_by_rate(rate, longest + 0.5 * self.period)
        return float(motion[2]) + risen + self.model.lag * rate

    def _observe(self, inputs: LawInput) -> float:
        """Advance the observer and return the resistance of the model at the measured state [N]."""
        model = self.model
        speed, reference = self.mean(inputs.velocity.tolist()), float(inputs.lookahead.velocity[0])
        resisting = model.resisting_force(model.front(inputs.position), speed, inputs.train_shoe_force)
        simulated = inputs.lookahead.simulated_force
        if simulated.size:
            slope = self._drag_slope[0] + self._drag_slope[1] * abs(reference)
            resisting = float(simulated[0]) + slope * (speed - reference)
        place = mean_over_units(self.share, (inputs.position + model.offsets).tolist())
        position_error, speed_error = place - float(inputs.lookahead.position[0]), speed - reference
        force = mean_over_units([1.0] * self.n, inputs.applied.tolist())
        by_line = model.line_force(model.front(inputs.position)) / model.inertia
        if self._before is None or (not simulated.size and self._stands(speed, reference)):
            self._observer.stand(position_error, speed, place, reference)
            regressor = by_line
        else:
            force_before, resisting_before, reference_before = self._before
            drive = self._weight * force_before + (1.0 - self._weight) * force
            pull = (drive - 0.5 * (resisting_before + resisting)) / model.inertia
            regressor = pull + by_line
            change = 0.0 if simulated.size else (reference - reference_before) / self.period
            force_change = (force - force_before) / model.inertia
            self._observer.step(position_error, speed_error, pull - change, regressor, force_change)
        self._before = (force, resisting, reference)
        mass_error = self._mass_error()
        rest = (self._observer.mass_error - mass_error) * regressor
        self._unexplained = self._observer.disturbance + mass_error * by_line + rest
        return resisting

    def _mass_error(self) -> float:
        """Return the part of the estimated error of the mass that the measurements support."""
        return self._observer.mass_error * self._observer.mass_known if self.parameters.identify else 0.0

    def _gain(self) -> float:
        """Return the gain of the actuators that the law uses."""
        return self._identification.gain if self.parameters.identify else 1.0

    def _feedforward(self, required: Array) -> list[float]:
        """Return the force of every unit that gives the required force at the time of its effect [N]."""
        model, tick, half = self.model, self.model.tick, 0.5 * self.period
        table = required[: self._entries].tolist()
        found = []
        for share, forward, backward in zip(*self._actuators[[2, 0, 1]].tolist(), strict=True):
            force = _through_lag(table, (forward + half) / tick, model.lag / tick)
            if force < 0.0 and backward != forward:
                force = min(0.0, _through_lag(table, (backward + half) / tick, model.lag / tick))
            found.append(force * share)
        return found

    def _decide(
        self, inputs: LawInput, required: Array, errors: Array, disturbance: float, rise: float, feedforward: float
    ) -> float:
        """Return the total force of the plan for now [N]."""
        last = plain_sum(self._last_force)
        at_nodes = node_values(required[self._entries - 1 :], self._nodes, PARTS)
        at_nodes[0] = feedforward
        later = inputs.lookahead
        reference = np.array([later.position[self._entries - 1 :: PARTS], later.velocity[self._entries - 1 :: PARTS]])
        allowed = np.empty(7 * self._nodes.size)
        now = self._gain() * np.array([float(inputs.force_min.sum()), float(inputs.force_max.sum())])
        side = self._sides[int(last < 0.0)]
        drag = (self._beyond_reference, *self._drag_slope)
        # a brake that acts does not last, and the simulated train had these limits
        tables = self._no_tables if self._simulated and inputs.train_shoe_force > 0.0 else self._tables
        self._largest = max(abs(self._observer.position_error), self._largest * self._memory)
        self._ends[3] = max(self._band, self._largest)
        bounds(
            at_nodes, reference, self._limits, self._ends, now, errors, (side.response_velocity, self._plan), drag,
            tables, self._force_range(reference + errors, later), self._inertia, self.parameters.jerk,
            self._steps, disturbance, rise, float(required[self._ticks]), allowed,
        )  # fmt: skip
        gradients = (side.gradient_position, side.gradient_velocity)
        exchanges = decide(
            gradients, side.inverse, side.limited, side.dual, side.constraints, errors, allowed, self._active,
            self._plan,
        )  # fmt: skip
        if exchanges < 0:
            self._failures += 1
            self._active[:] = False
            self._plan = np.interp(self._nodes + self.period, self._nodes, self._plan)
        else:
            self._most_exchanges = max(self._most_exchanges, exchanges)
            self._limited_steps += bool(self._active.any())
        reference[:, 0] = later.position[self._ticks], later.velocity[self._ticks]
        self._decided = (
            self._ticks * self.model.tick + self._nodes, reference, errors, side, self._plan.copy(),
            at_nodes + self._inertia * (self._plan - disturbance), allowed[4 * self._nodes.size : 5 * self._nodes.size],
            SOLVED if exchanges >= 0 else CONTINUED,
        )  # fmt: skip
        return feedforward + self._inertia * (float(self._plan[0]) - disturbance)

    def planned(self) -> LawPlan | None:
        """Return the plan of the last decision."""
        return planned_motion(*self._decided)

    def _force_range(self, motion: Array, ahead: Lookahead) -> Array:
        """Return the range of the total force at the nodes for couplers and sections of the line [N]."""
        within = self._within_couplers(motion)
        if not self._sections or not ahead.force_max.size:
            return within
        return limits_at_nodes(ahead.force_min, ahead.force_max, self._nodes, PARTS, self._ticks, within)

    def _within_couplers(self, motion: Array) -> Array:
        """Return the smallest and largest total force at the nodes for the coupler forces [N], shape (2, nodes).

        The couplers do not limit later brake forces of a train with an air brake, as the envelopes do not.
        """
        if self._couplers is None:
            return self._unbounded
        found = self._couplers.force_range(motion[0], motion[1])
        if self.model.air_brake is not None:
            found[0, 1:] = -np.inf
        return found


def _through_lag(table: list[float], place: float, lag: float) -> float:
    """Return F + Ta F' at a place of a table, with the lag in entries."""
    index = min(int(place + 1e-9), len(table) - 2)
    rise = table[index + 1] - table[index]
    return table[index] + (place - index) * rise + lag * rise
