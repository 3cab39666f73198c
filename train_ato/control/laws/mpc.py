"""Constrained model predictive control of the train as one mass, with exact delays and a look-ahead of 120 s (ours).

The law predicts the errors of position and speed over the delay, unit by unit. It uses the measured forces and the
commands in flight. Then it plans the force over the next two minutes under its limits, so that it reacts early to a
force limit ahead.

F is the total force, R the force that keeps the train on the reference, d the disturbance, g the gain, and c the factor
on the delays::

    e_p' = e_v,   e_v' = (F - R)/M + d,   R = M v_d' + W(x_d, v_d)
    F_i' = (g u_i(t - c tau_i) - F_i)/Ta
    u_i = share_i [R + Ta R' + M (z - d)]/g
    J = sum_k W_k [(a omega²)² e_p² + (4 - 2a) omega² e_v²] + sum_j w_j z_j² + T (a omega²)² b²

z(s) is linear between 32 nodes at geometrically growing distances. Without constraints it is -2 omega e_v - a omega²
e_p on the state at the time of effect. The limits of force, jerk, speed, couplers, stops and of the largest error b are
soft. `msgs_docs/mpc_derivation.md` derives all parts: observers, constraints and their solution, standstill, the units
of a train, and the identification of the actuators.

Safe gains: a misfit of the actuators of 15 % switches them on, and a misfit below 5 % switches them off. The plan then
has ``safe_share`` of omega, and the units have no regulator. With ``identify`` false the model itself is tested in this
way.

Limits: the air brake is only a known force. With hauled vehicles the error of the mass is not estimated. Where other
laws are better: two locomotives with 210 wagons without `twin` (`pid`). A reference with steps of the speed
(`freight_consensus` without `realistic`) is not tracked. Goals, misses and other solvers: `msgs_docs/mpc_goals.md`,
made with `python studies_done/mpc.py`, `python studies_done/mpc_solvers.py` and, for soft couplers, with
`studies_done/freight_front.py` and `studies_done/freight_lines.py`.

Needs: any train; delay, lag and envelopes of the model, the measured force, and the reference ahead. The law predicts
over the delay and has its own feed-forward: use compensation `none` or `preview`, with hauled vehicles `twin`.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from plant_sim.elementary import mean_over_units, plain_sum, total_of_units
from plant_sim.record import zeros
from train_ato.control.algorithms.coupler_modes import bandwidth_text
from train_ato.control.algorithms.limits_ahead import limits_force, within_units
from train_ato.control.algorithms.train_constants import default_bandwidth, train_class
from train_ato.control.contract import LawInput, LawPlan, flag, parameter
from train_ato.control.gains import model_choice
from train_ato.control.guard import GuardedLaw, is_valid
from train_ato.control.mpc.actuator_identification import WRONG_MISFIT, ActuatorIdentification
from train_ato.control.mpc.force_plan import PARTS, ForcePlan
from train_ato.control.mpc.measured_motion import SIMULATED_SHARE, MeasuredMotion, follow_simulation
from train_ato.control.mpc.motion_observer import SPEED_PRIOR, motion_by_rate
from train_ato.control.mpc.predictive_plan import PlanStart, RelativeMotion, free_motion
from train_ato.control.mpc.standstill_force import StandstillForce
from train_ato.control.mpc.unit_deviations import UnitDeviations
from train_ato.control.observers.force_balance import lag_weight
from train_ato.control.train_model import Actuator, TrainModel
from train_ato.messages.types import Array

IDENTIFICATION_SPEED = 1.0
"""Speed below which the electric brake fades and the commands do not explain the force [m/s]."""


@dataclass(frozen=True)
class MpcParameters:
    """Parameters of :class:`Mpc`."""

    gains: str = model_choice()
    omega: float = parameter(
        0.0, "rad/s", 0.0, 10.0, "half of the gain on the speed error; 0: from delay, lag and couplers"
    )
    observer_ratio: float = parameter(
        0.0,
        "1",
        0.0,
        100.0,
        "bandwidth of the observer over omega; 0: 5, or 6 (one vehicle), 2.5 (soft couplers), 1 (hauled)",
    )
    lookahead: float = parameter(120.0, "s", 1.0, 600.0, "length of the horizon")
    nodes: int = parameter(32, "1", 4, 60, "nodes of the decision over the horizon")
    jerk: float = parameter(1.0, "m/s³", 0.01, 1e6, "largest change of the demanded acceleration")
    overspeed: float = parameter(0.1, "m/s", 0.0, 10.0, "permitted excess of a speed limit")
    identify: bool = flag("estimate gain and delay of the actuators", default=True)
    coupler_limit: float = parameter(
        0.0, "N", 0.0, 1e8, "largest coupler force of the plan for a train without waves; 0: no limit"
    )
    safe_share: float = parameter(0.3, "1", 0.05, 1.0, "part of omega while the model of the actuators is not safe")
    speed_noise: float = parameter(
        SPEED_PRIOR, "m/s", 0.0, 1.0, "standard deviation of the measured speed at which its estimate begins"
    )
    position_share: float = parameter(
        0.0, "1", 0.0, 1.0, "a: gain on the position error over omega². 0 means .5, and 1 with hauled vehicles"
    )


class Mpc(GuardedLaw):
    """Constrained model predictive control with exact delays and a long look-ahead (ours)."""

    Parameters: ClassVar[type] = MpcParameters
    uses_feedforward = False
    predicts_delay = True

    @classmethod
    def model_gains(cls, model: TrainModel, period: float) -> dict[str, Any]:
        """Return no value: the default 0 of omega, observer ratio and position share is computed from the model."""
        return {}

    @classmethod
    def gains_note(cls, model: TrainModel, given: Mapping[str, Any]) -> str:
        """Return the default of omega and its conditions as text, "" for a given omega."""
        return "" if given.get("omega") else bandwidth_text(model)

    def __init__(self, parameters: MpcParameters, model: TrainModel, period: float) -> None:
        super().__init__(parameters, model, period)
        p = parameters
        self.omega = p.omega or default_bandwidth(model).omega
        self._force_plan = ForcePlan(
            model, period, omega=self.omega, lookahead=p.lookahead, nodes=p.nodes, jerk=p.jerk,
            overspeed=p.overspeed, coupler_limit=p.coupler_limit,
        )  # fmt: skip
        self._identification = ActuatorIdentification(model, period, estimates=p.identify)
        self._class = train_class(model, self.omega)
        self.follows_simulation = self._class.hauls
        weight = lag_weight(period, model.lag)
        self._deviations = UnitDeviations(model, period, weight) if self._class.soft else None
        self._motion = MeasuredMotion(
            model, period, omega=self.omega, ratio=p.observer_ratio or self._class.observer_ratio, weight=weight,
            speed_noise=p.speed_noise, use_mass=p.identify,
        )  # fmt: skip
        self._standstill = StandstillForce(model, period)
        self._sections = limits_force(model.line)
        self.clear_state()

    def _set_delays(self, factor: float) -> None:
        """Take the delays of the model times a factor: prediction, matrices and times of the lookahead."""
        model, p = self.model, self.parameters
        delays = np.array([factor * model.delay, factor * model.delay_brake])
        self._actuators = zeros(Actuator, self.n)
        self._actuators["share"], self._actuators["forward"], self._actuators["backward"] = model.share, *delays
        self._ticks = math.ceil(float(delays.max()) / model.tick - 1e-9)
        self._entries = self._ticks + 2 + math.ceil(0.5 * self.period / model.tick)
        after = self._ticks * model.tick + self._force_plan.times[1:]
        self.lookahead_times: Array = np.concatenate((model.tick * np.arange(self._entries), after))
        self._effects = [[self._place(delay) for delay in pair] for pair in delays.T.tolist()]
        omega = self.omega * (p.safe_share if self._cautious else 1.0)
        share = SIMULATED_SHARE if self._simulated else p.position_share or self._class.position_share
        self._force_plan.set_delays(delays, self._ticks, self._entries, omega, share)

    def clear_state(self) -> None:
        """Clear observer, identification, plan and counts."""
        self._motion.reset()
        self._identification.reset()
        self._standstill.reset()
        self._force_plan.reset()
        if self._deviations is not None:
            self._deviations.reset()
            self._deviations.lines.reset()
        self._cautious_steps = 0
        self._cautious = self._simulated = False
        self._set_delays(1.0)

    def take_over(self, inputs: LawInput, force: Array) -> None:
        """Begin with the commands in flight, without which the prediction would lack their force."""
        super().take_over(inputs, force)
        if is_valid(inputs):
            self._identification.take_over(inputs.commands_in_flight, force, inputs.applied)

    def on_missed_sample(self) -> None:
        """Handle a missed sample: the observer restarts at the next one with the present disturbance."""
        self._motion.miss()
        if self._deviations is not None:
            self._deviations.reset()

    def diagnostics(self) -> dict[str, str]:
        """Return the counts of the solver and the disturbance as text."""
        observer, plan = self._motion.observer, self._force_plan
        lines = {} if self._deviations is None else {"disturbance_lines": self._deviations.lines.text()}
        return {
            "limited_steps": str(plan.limited_steps),
            "most_exchanges": str(plan.most_exchanges),
            "solver_failures": str(plan.failures),
            "disturbance": repr(observer.disturbance),
            "delay_factor": repr(self._identification.factor),
            "actuator_gain": repr(self._identification.gain),
            "actuator_model": "wrong" if self._identification.model_is_wrong else "right",
            "cautious_steps": str(self._cautious_steps),
            "mass_error": repr(observer.mass_error),
            "speed_noise": repr(observer.speed_noise),
            **lines,
        }

    def planned(self) -> LawPlan | None:
        """Return the plan of the last decision."""
        return self._force_plan.planned()

    def demand(self, inputs: LawInput) -> list[float]:
        """Return the force demand of every unit [N]."""
        if inputs.lookahead.simulated_force.size and not self._simulated:
            self._simulated = True
            self._motion.begin_simulated()
            self._set_delays(self._identification.factor)
        changed = self._identify(inputs)
        wanted = self._wanted(inputs)
        self._cautious_steps += self._cautious
        if changed or self._cautious != self._identification.model_is_unsafe:
            self._cautious = self._identification.model_is_unsafe
            self._set_delays(self._identification.factor)
        return wanted

    def _identify(self, inputs: LawInput) -> bool:
        """Compare the measured force with the commands; return True for a new delay, for the next step on."""
        in_flight = inputs.commands_in_flight
        last = in_flight[-1] if in_flight.size else np.array(self._last_force)
        moves = abs(self.mean(inputs.velocity.tolist())) > self._motion.rest_speed(IDENTIFICATION_SPEED)
        return self._identification.step(last, mean_over_units([1.0] * self.n, inputs.applied.tolist()), moves)

    def _wanted(self, inputs: LawInput) -> list[float]:
        """Return the force of the plan for every unit [N]."""
        gain = self._identification.gain if self.parameters.identify else 1.0
        sent = gain * (self._identification.sent if self.parameters.identify else inputs.commands_in_flight)
        if self._deviations is not None:
            inputs, sent = self._deviations.lines.step(inputs, sent, self._actuators, trusted=not self._cautious)
        self._motion.step(inputs)
        ahead, inertia = inputs.lookahead, self._motion.inertia
        count, simulated = self._ticks + 1, ahead.simulated_force
        required = follow_simulation(inertia * ahead.acceleration + ahead.resistance, simulated, count)
        forward = inputs.feedforward.tolist() if simulated.size else self._feedforward(required)
        measured = self._motion
        disturbance = measured.unexplained - measured.beyond_reference / inertia
        motion = RelativeMotion(measured.observer.position_error, measured.observer.speed_error, disturbance, 0.0)
        lag, tick = self.model.lag, self.model.tick
        motion = free_motion(motion, inputs.applied, sent, required[:count], self._actuators, tick, lag, inertia)
        motion, disturbance = self._with_rate(motion)
        total = self._total_force(inputs, required, motion, disturbance, feedforward=plain_sum(forward), gain=gain)
        added = total - plain_sum(forward)
        wanted = [force + added * share for force, share in zip(forward, self.share, strict=True)]
        if self._deviations is not None:
            between = self._deviations.forces(inputs, sent, self._actuators, self._ticks)
            more = self._deviations.lines.command + (0.0 if self._cautious else np.array(between))
            wanted = [force + each for force, each in zip(wanted, more.tolist(), strict=True)]
        effect, later = self._ticks, self._entries - 1 + PARTS
        places = float(ahead.velocity[effect]), float(ahead.acceleration[effect]), float(ahead.velocity[later])
        force = float(required[effect] + inertia * (motion.acceleration_error - disturbance))
        wanted = self._standstill.limited(wanted, motion, places, inertia, force, at_rest=self._motion.observer.stands)
        if self._sections and ahead.force_max.size:
            low, high = ahead.force_min[effect].tolist(), ahead.force_max[effect].tolist()
            wanted = within_units(wanted, self.share, low, high)
        return [force / gain for force in wanted]

    def _with_rate(self, motion: RelativeMotion) -> tuple[RelativeMotion, float]:
        """Return the motion at the time of effect with the rate of the disturbance, and d + Ta d' there [m/s²]."""
        rate, longest = self._motion.observer.disturbance_rate, self._ticks * self.model.tick
        position, speed, risen, _ = motion_by_rate(rate, longest)
        motion = RelativeMotion(
            motion.position_error + position, motion.speed_error + speed, motion.disturbance,
            motion.acceleration_error + risen,
        )  # fmt: skip
        _, _, risen, rate = motion_by_rate(rate, longest + 0.5 * self.period)
        return motion, motion.disturbance + risen + self.model.lag * rate

    def _total_force(
        self, inputs: LawInput, required: Array, motion: RelativeMotion, disturbance: float, *, feedforward: float,
        gain: float,
    ) -> float:  # fmt: skip
        """Return the total force of the plan for now [N]."""
        inertia, last = self._motion.inertia, plain_sum(self._last_force)
        rise = (feedforward - required.item(self._ticks)) / inertia - motion.acceleration_error
        if self.model.lag == 0.0:
            rise = (feedforward - gain * last) / inertia - disturbance
        known = gain if abs(gain - 1.0) > WRONG_MISFIT else 1.0  # the misfit of a right model explains the rest
        start = PlanStart(
            required, motion, disturbance, passing=self._motion.passing, rise=rise, feedforward=feedforward,
            last_force=last, force_min=gain * total_of_units(inputs.force_min),
            force_max=gain * total_of_units(inputs.force_max), position_error=self._motion.observer.position_error,
            beyond_reference=self._motion.beyond_reference, inertia=inertia, gain=known,
            air_brake_acts=inputs.train_shoe_force > 0.0,
            departs=self._motion.observer.stands and not self._class.hauls,
        )  # fmt: skip
        return self._force_plan.decide(start, inputs.lookahead, simulated=self._simulated)

    def _place(self, delay: float) -> tuple[int, int, float, float, float]:
        """Return two entries of the lookahead, their distance, and the effect of a command after the first, plus lag.

        Through the lag Ta the command is F + Ta F'. The line force of a train of wagons is a staircase, one step for
        every wagon at a change of the grade, and F' of a step is an impulse. With hauled vehicles the command is
        therefore F at the time Ta later, equal to F + Ta F' for a steady slope.
        """
        tick, half, lag = self.model.tick, 0.5 * self.period, self.model.lag
        if not self._class.hauls:
            place = (delay + half) / tick
            index = min(int(place + 1e-9), self._entries - 2)
            return index, index + 1, 1.0, place - index, lag / tick
        order = np.argsort(self.lookahead_times, kind="stable")
        times, time = self.lookahead_times[order], delay + (half + lag)
        k = min(int(np.searchsorted(times, time, side="right")), times.size - 1) - 1
        width = float(times[k + 1] - times[k])
        return int(order[k]), int(order[k + 1]), width, min(time - float(times[k]), width), 0.0

    def _feedforward(self, required: Array) -> list[float]:
        """Return the force of every unit that gives the required force at the time of its effect [N]."""

        def force_at(effect: tuple[int, int, float, float, float]) -> float:
            first, then, width, after, lag = effect
            rise = (required.item(then) - required.item(first)) / width
            return required.item(first) + after * rise + lag * rise

        found = []
        for (forward, backward), share in zip(self._effects, self.share, strict=True):
            force = force_at(forward)
            if force < 0.0 and backward != forward:
                force = min(0.0, force_at(backward))
            found.append(force * share)
        return found
