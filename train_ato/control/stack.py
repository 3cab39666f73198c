"""Control stack: compensation, law, guards, change of the law without a jump of the force, brake policy."""

import copy
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from plant_sim.elementary import dot_of, total_of_units
from plant_sim.record import zeros
from train_ato.control import component_fault as fault
from train_ato.control import takeover
from train_ato.control.air_brake.record_policy import BrakePolicy
from train_ato.control.command_hold import CommandHold, command_at_standstill, profile_at_standstill
from train_ato.control.compensation.contract import Compensation, CompensationInput
from train_ato.control.compensation.rigid import RigidForce
from train_ato.control.contract import Law, LawInput, LawOutput, ProfileLike
from train_ato.control.force_distribution import ForceDistribution, PlannedDisplacement
from train_ato.control.guard import LawUnit, all_within, is_valid, is_valid_state, limit_commands
from train_ato.control.law import RecordLaw
from train_ato.control.plan_text import TimedPlan, plan_to_text
from train_ato.control.train_model import TrainModel, stands
from train_ato.messages.types import Array, DisturbanceEstimate, Measurement, Reference
from train_ato.messages.validity import MAX_FORCE


class ControlStack:
    """Computation of the command from a measurement.

    Parameters
    ----------
    model
        The nominal train.
    period
        Period of the law [s], an integer multiple of the tick; the command is held in between.
    controller
        Name of the law.
    controller_parameters
        Parameters that differ from the defaults, by law.
    compensation
        The delay compensation.
    brake_policy
        Policy of the air brake.
    profile
        The speed profile.
    hold_limit
        Maximum time for which the last command is repeated without a valid new one [s].
    make_law
        Returns the law for name, parameters and period.
    distribution
        Shares of the power units by place; None: the forces of the law.
    displacement
        Planned displacements of the power units by place; None: none.
    jerk_limit
        Largest jerk of a change of the law or of a takeover [m/s³], if the jerk of the profile is larger.
    authority
        Returns largest place [m] and permitted speeds [m/s] at a time [ns] and places [m], see
        :class:`train_ato.loop.train_ahead.AuthorityAhead`; None: no train ahead.

    Attributes
    ----------
    law, compensation, policy, profile, rigid
        Parts of the stack, and forces of the rigid train along the profile.
    last : list of float
        Last command of every unit [N].
    in_flight : Array, shape (d, units)
        Commands sent and not yet in effect, one per tick, oldest first [N].
    pressure : float or None
        Pressure of the brake pipe demanded [Pa], before the first measurement that of a released brake; None without
        an air brake.
    every, ticks, saturated_steps : int
        Ticks between two steps of the law, ticks so far, and steps at a limit so far.
    saturated : bool
        The last step was at a limit.
    delay_to_effect : float
        Longest delay and lag of a command [s].
    answer : LawOutput or exception, optional
        Result of the law in a compiled tick, used in place of its next step.
    law_brakes : bool
        The law demanded the pressure of the last step in place of the policy.
    plan : TimedPlan or None
        Newest plan of the law; None for a law without.
    fed : tuple of Array, shape (units,) each
        Feed-forward and estimated disturbance at the last step of the law [N].
    hold : CommandHold
        Steps that repeated the previous command, because the measurement or the output of the law was not valid.

    Raises
    ------
    ValueError
        If the law, its parameters or the period are rejected.
    """

    def __init__(
        self,
        model: TrainModel,
        period: float,
        controller: str,
        controller_parameters: Mapping[str, Mapping[str, Any]],
        compensation: Compensation,
        brake_policy: BrakePolicy,
        profile: ProfileLike,
        hold_limit: float,
        make_law: Callable[[str, Mapping[str, Any], float], Law],
        distribution: ForceDistribution | None = None,
        displacement: PlannedDisplacement | None = None,
        jerk_limit: float = takeover.DEFAULT_JERK,
        authority: Callable[[int, Array], tuple[float, Array]] | None = None,
    ) -> None:
        self.model = model
        self.period = period
        self.every = round(period / model.tick)
        if self.every < 1 or abs(self.every * model.tick - period) > 1e-9:
            raise ValueError(
                f"control_period: {period:g} s is not a multiple of the tick {model.tick:g} s; choose a multiple"
            )
        self._make_law = make_law
        self._set_law(controller, controller_parameters.get(controller, {}))
        self.compensation, self._compensation_limit = compensation, fault.step_limit(compensation)
        self._own_compensation = fault.is_own(compensation)
        self.policy = brake_policy
        self._distribution, self._displacement = distribution, displacement
        self.delay_to_effect = model.longest_delay + model.lag
        brake = model.consist.air_brake
        self._air_brake = brake is not None
        self.in_flight = model.commands_in_flight()
        self._jerk_limit, self._authority = jerk_limit, authority
        self.ticks = self.saturated_steps = 0
        self._swaps = self._invalid_measurements = self._invalid_estimates = 0
        self.last: list[float] = [0.0] * model.n_units
        self._before = self.last
        self._units = zeros(LawUnit, model.n_units)
        self._transition: takeover.LawTransition | None = None
        self._takes_over = self._joins = False
        self._joined: takeover.JoinedReference | None = None
        self._braking: takeover.TakeoverRamp | None = None
        self.pressure: float | None = None if brake is None else brake.charged  # lockstep awaits one in every tick
        self._shoes_act = self.law_brakes = self.saturated = False
        self.hold = CommandHold(hold_limit, period)
        self._fault: BaseException | None = None
        self._fault_text = ""
        self._no_disturbance = np.zeros(model.n_units)
        self.answer: LawOutput | BaseException | None = None
        self.plan: TimedPlan | None = None
        self.fed = self._no_disturbance, self._no_disturbance
        self.set_profile(profile)
        set_brake_policy = getattr(compensation, "set_brake_policy", None)
        if set_brake_policy is not None:
            set_brake_policy(copy.deepcopy(brake_policy))
        self._on_command_sent = getattr(compensation, "on_command_sent", None)

    def set_profile(self, profile: ProfileLike) -> None:
        """Set the profile, at the start or after re-planning."""
        self.profile, self.rigid = profile, RigidForce(self.model, profile)
        self.compensation.set_profile(self.rigid)

    def _set_law(self, name: str, parameters: Mapping[str, Any]) -> None:
        self.law: Law = self._make_law(name, parameters, self.period)
        self._law_limit, self._name = fault.step_limit(self.law), name
        self._is_guarded = getattr(type(self.law), "step", None) is RecordLaw.step

    def swap(self, name: str, parameters: Mapping[str, Any]) -> None:
        """Change the law or its parameters without a jump of the force.

        The new law takes over in the state of the run, see :class:`train_ato.control.contract.Law`. Its demand begins
        at the last command and changes at most as :mod:`train_ato.control.takeover` permits. After the braking law the
        change of its takeover applies. The reference of another law begins in the state of the train and joins the
        profile. With other parameters of the same law the reference does not change, because the errors are those of
        this law.

        Raises
        ------
        ValueError
            With the reason; the law is then unchanged.
        """
        another = name != self._name
        self._set_law(name, parameters)
        self._fault = self.plan = None
        change = takeover.largest_change(self.model, takeover.transition_jerk(self.profile, self._jerk_limit))
        if self._braking is not None:
            change = self._braking.change
        self._transition = takeover.LawTransition(change, self.model.tick)
        self._takes_over, self._joined = True, None
        self._joins = another and self._braking is None
        self._braking = None
        self._swaps += 1

    def brake(self, force: Array, least_jerk: float = 0.0) -> Array:
        """Return the command of this step for the demand of the braking law; a law that brakes more keeps its own.

        Parameters
        ----------
        force : Array, shape (units,)
            Demand of the braking law [N].
        least_jerk
            Jerk that a limit demands at the takeover [m/s³].
        """
        if self._braking is None:
            jerk = takeover.transition_jerk(self.profile, self._jerk_limit)
            self._braking = takeover.TakeoverRamp(self.model, jerk, np.array(self._before), least_jerk)
        sent = self._braking.step(force, force, np.array(self.last))
        self.last = sent.tolist()
        self.in_flight[-1:] = sent
        return sent

    @property
    def in_transition(self) -> bool:
        """True from a change of the law until its demand and the profile are reached."""
        return self._transition is not None or self._joined is not None

    def diagnostics(self) -> dict[str, str]:
        """Return the counts of the guards, and the diagnostics of the law under its name, as text."""
        return {
            "unsound_measurements": str(self._invalid_measurements),
            "unsound_estimates": str(self._invalid_estimates),
            "held_steps": str(self.hold.total),
            "saturated_steps": str(self.saturated_steps),
            "swaps": str(self._swaps),
            **self._texts_of_law(),
            **({} if self.plan is None else plan_to_text(self.plan, held=self.hold.in_a_row > 0)),
        }

    def _texts_of_law(self) -> dict[str, str]:
        """Return the diagnostics of the law under its name; without them after an error, which ends its steps."""
        try:
            with self._law_limit:
                found: Any = getattr(self.law, "diagnostics", dict)()
                if text := fault.diagnostics_fault(self._name, self.law, found):
                    raise fault.ComponentFailed(text)
                return {
                    fault.printable(f"{self._name}.{key}"): fault.printable(str(value)) for key, value in found.items()
                }
        except BaseException as error:  # a user-defined law may raise any
            if self._fault is None:
                self._take_fault("law", self._name, error)
            return {}

    def _take_fault(self, kind: str, name: str, error: BaseException) -> None:
        """Note an error of the law or the compensation, which gets no further step."""
        fault.raise_if_interrupted(error)
        self._fault = error
        self._fault_text = (
            str(error) if isinstance(error, fault.ComponentFailed) else fault.fault_of_error(kind, name, error)
        )

    @property
    def has_fault(self) -> bool:
        """True after an error of the law or the compensation, which gets no further step."""
        return self._fault is not None

    def step(
        self, measurement: Measurement, reference: Reference | None, estimate: DisturbanceEstimate | None
    ) -> tuple[Array, float | None]:
        """Return the command of one tick.

        Parameters
        ----------
        measurement
            Newest measurement; if its values are not valid, the last command is held.
        reference
            Newest reference; without one the last command is held.
        estimate
            Newest estimate; without one the disturbance counts as 0.

        Returns
        -------
        force : Array, shape (units,)
            Force demand of every unit [N].
        pressure : float or None
            Brake-pipe pressure demanded [Pa]; None without an air brake.

        Raises
        ------
        RunFailed
            If the last command was repeated for longer than ``hold_limit``; after a fault of the law or the
            compensation it is :class:`ComponentFailed`.
        """
        if self.hold.in_a_row:
            self.hold.check_limit(self._fault)
        due = self.ticks % self.every == 0
        self.ticks += 1
        self._before = self.last
        decided = False
        valid = is_valid_state(measurement)
        if not valid:
            self._invalid_measurements += 1
        elif self._air_brake:
            self.pressure = self.policy.step(
                measurement.stamp * 1e-9,
                self.model.front(measurement.position),
                float(measurement.velocity[0]),
                total_of_units(measurement.applied),
            )
            self.law_brakes = False
        if due and valid and reference is not None:
            self.last = self._decide(measurement, reference, estimate)
            if not getattr(self.law, "open_loop", False) and stands(measurement.velocity):
                self.last = self._at_standstill(np.array(self.last), measurement, reference)
            decided = True
        elif due:
            self.hold.hold("no valid reference" if valid else "no valid measurement of the power units")
            self._miss_sample()
        if self._transition is not None:
            self.last = self._in_transition(self._transition, measurement, decided=decided)
        if decided and self._on_command_sent is not None:
            self._on_command_sent(np.array(self.last))
        force = np.array(self.last)
        self.in_flight[:-1] = self.in_flight[1:]
        self.in_flight[-1:] = force
        return force, self.pressure

    def _miss_sample(self) -> None:
        """Call the method of the law for a tick without a step."""
        if self._fault is None:
            try:
                with self._law_limit:
                    getattr(self.law, "on_missed_sample", lambda: None)()
            except BaseException as error:  # a user-defined law may raise any
                self._take_fault("law", self._name, error)

    def _at_standstill(self, force: Array, measurement: Measurement, reference: Reference) -> list[float]:
        """Return the command of a train at standstill [N]."""
        later = self.profile.at_times(np.array([measurement.stamp * 1e-9 + self.delay_to_effect]))
        now = np.array([[reference.velocity], [reference.acceleration]])
        (rests,), (departs,) = profile_at_standstill(now[0], now[1], later, self.model)
        command_at_standstill(force, measurement.velocity, rests, departs)
        found: list[float] = force.tolist()
        return found

    def _decide(
        self, measurement: Measurement, reference: Reference, estimate: DisturbanceEstimate | None
    ) -> list[float]:
        low, high = self.model.force_limits(measurement.velocity)
        known = measurement.copy()  # a law may write into its inputs
        if self._displacement is not None:
            known = self._displacement.without(known, self.model.front(measurement.position))
        answered = self._answered(known, reference, estimate, low.copy(), high.copy())
        if answered is None:
            return self.last
        inputs, output = answered
        if output.plan is not None:
            self.plan = TimedPlan(inputs.t, output.plan)
        if output.held:
            valid = is_valid(inputs)
            spoilt = self._own_compensation and not valid and "coupler_force" not in output.held  # that of a sensor
            place = fault.step_of(self.law)[0] if valid else ""
            law = f"law '{self._name}' repeated its last force ({output.held}{place})"
            reason = fault.answer_fault(self.compensation, output.held) if spoilt else law
            self.hold.hold(reason, by_component=valid or spoilt)
        else:
            self.hold.in_a_row = 0
        if self._air_brake and output.brake_pipe is not None:
            brake = self.model.consist.air_brake
            self.pressure = min(max(output.brake_pipe, 0.0), brake.charged)  # type: ignore[union-attr]
            self.law_brakes = True
        units = self._units
        units["wanted"], units["force_min"], units["force_max"] = output.force, low, high
        self.saturated = bool(limit_commands(units) > 0)
        self.saturated_steps += self.saturated
        sent: list[float] = units["force"].tolist()
        if self._distribution is None:
            return sent
        front = self.model.front(measurement.position)
        return self._distribution.forces(front, sent, low.tolist(), high.tolist())

    def _answered(
        self,
        measurement: Measurement,
        reference: Reference,
        estimate: DisturbanceEstimate | None,
        low: Array,
        high: Array,
    ) -> tuple[LawInput, LawOutput] | None:
        """Return inputs and output of the law; None after a fault of law or compensation, which counts as held step.

        After an exception the state of the component is not known, so it gets no further step. An invalid estimate
        counts as 0. The step of a law over records has checked its output itself.
        """
        answer, self.answer = self.answer, None
        if self._fault is None:
            disturbance = (self._no_disturbance if estimate is None else estimate.force).copy()
            if not all_within(disturbance, MAX_FORCE):
                disturbance = self._no_disturbance.copy()
                self._invalid_estimates += 1
            kind, name = "compensation", type(self.compensation).__name__
            try:
                with self._compensation_limit:
                    seen = CompensationInput(
                        measurement, reference, disturbance, self.in_flight.copy(),
                        self.pressure, low, high, self.saturated, getattr(self.law, "horizon", 0),
                        getattr(self.law, "lookahead_times", None),
                        None if self._authority is None else partial(self._authority, measurement.stamp),
                    )  # fmt: skip
                    inputs = self.compensation.step(seen)
                if self._own_compensation and (
                    text := fault.inputs_fault(self.compensation, inputs, self.model.n_units)
                ):
                    raise fault.ComponentFailed(text)
                self._shoes_act = inputs.train_shoe_force != 0.0
                if self._joins or self._joined is not None:
                    inputs = self._on_joined_reference(inputs)
                kind, name = "law", self._name
                with self._law_limit:
                    if self._transition is not None:
                        inputs = self._taken_over(inputs, self._transition)
                    uses = getattr(self.law, "uses_feedforward", True)
                    self.fed = (inputs.feedforward if uses else self._no_disturbance).copy(), inputs.disturbance.copy()
                    output = self.law.step(inputs) if answer is None else fault.unless_raised(answer)
                if not self._is_guarded:
                    self._fault_text = fault.output_fault(name, self.law, output, self.model.n_units)
                if not self._fault_text:
                    return inputs, output
            except BaseException as error:  # a user-defined law may raise any
                self._take_fault(kind, name, error)
        self.hold.hold(self._fault_text, by_component=True)
        return None

    def _on_joined_reference(self, inputs: LawInput) -> LawInput:
        """Return the inputs with the reference of a new law, see :class:`JoinedReference`."""
        if self._joins and is_valid(inputs):
            self._joins = False
            self._joined = takeover.JoinedReference(inputs, self.model.share, self.profile, self._lasting_force(inputs))
        if self._joined is None:
            return inputs
        if self._joined.has_joined(inputs.t):
            self._joined = None
            return inputs
        return self._joined.of(inputs, self.period, getattr(self.law, "lookahead_times", None))

    def _lasting_force(self, inputs: LawInput) -> Array:
        """Return the force that the old law added lastingly [N]; 0 with an air brake in action or a simulated train.

        A unit at its limit removes an error, and holds no unknown force. The force of a departure that stretches the
        couplers is not that of the whole train.
        """
        model, commands = self.model, inputs.commands_in_flight
        if inputs.train_shoe_force != 0.0 or getattr(self.compensation, "simulates_train", False):
            return 0.0 * self._no_disturbance
        if takeover.stretches(model, self.profile, inputs.t):
            return 0.0 * self._no_disturbance
        times = inputs.t + model.tick * np.arange(-len(commands), 0.0)[:, None] + model.delay
        nominal = self.rigid.aheads(times.ravel(), model.lag).reshape(commands.shape) * model.share
        limited = (
            (commands >= takeover.AGREED * inputs.force_max) | (commands <= takeover.AGREED * inputs.force_min)
        ).any(axis=0)
        return np.where(limited, inputs.disturbance, takeover.lasting_force(commands, nominal) + inputs.disturbance)

    def _taken_over(self, inputs: LawInput, transition: takeover.LawTransition) -> LawInput:
        """Return the inputs of a law in its transition, whose force limits are those that its demand can reach.

        At its first step the law takes over the run, if it has the method for it.
        """
        last = np.array(self._before)
        if self._takes_over:
            self._takes_over = False
            take_over = getattr(self.law, "take_over", None)
            if take_over is not None:
                take_over(inputs, last)
        if self._distribution is not None:
            return inputs  # the law's forces are not yet those of the units
        reach = transition.reach(self.every)
        low, high = inputs.force_min, inputs.force_max
        return replace(inputs, force_min=np.clip(last - reach, low, high), force_max=np.clip(last + reach, low, high))

    def _in_transition(
        self, transition: takeover.LawTransition, measurement: Measurement, *, decided: bool
    ) -> list[float]:
        """Return the command after a change of the law: from the last one towards the demand.

        A limit of the speed that falls faster than the largest change does not cut it: the unit is at its limit then.
        """
        if decided:
            self.last = self._before_corner(transition, measurement)
        sent = transition.step(self.last if decided else None, self._before, self.every)
        if transition.ended:
            self._transition = None
        elif decided:
            self.saturated |= sent != self.last
        return sent

    def _before_corner(self, transition: takeover.LawTransition, measurement: Measurement) -> list[float]:
        """Return the demand of the law, or before a corner of the profile the one that changes early enough [N].

        In motion the demand of the law keeps its difference from the force of the profile inside the limits of the
        units; one at the limit that it can reach is not known beyond it. From the begin of an early change on the
        difference is that of the begin: the law would remove the speed that the early change gains for the corner. A
        train far from its profile is not yet at its corner: a late one still brakes when the profile is at rest. With
        an air brake in action the force of the profile is not that of the units alone. Nor is it always divided by the
        shares on an uneven train.
        """
        t = measurement.stamp * 1e-9
        place, speed, *_ = self.profile.at(t)
        rests = speed == 0.0
        if not transition.is_bounded or self.model.uneven or (self._brakes_by_air() and not rests):
            return self.last
        off = self.model.front(measurement.position) - place, float(measurement.velocity[0]) - speed
        if transition.beyond is None and takeover.is_far(*off):
            return self.last
        model, ticks, last = self.model, np.arange(transition.lasting)[:, None], np.array(self._before)
        by_unit = getattr(self.law, "uses_feedforward", True)
        delays = model.delay if by_unit else np.full(model.n_units, dot_of(model.delay, model.share))
        effects = (t + 0.5 * self.period + model.tick * ticks + delays).ravel()
        required = self.rigid.aheads(effects, model.lag).reshape(-1, model.n_units) * model.share
        reach, demand = transition.reach(self.every), np.array(self.last)
        least = np.where(demand >= last + takeover.AGREED * reach, 0.0, -np.inf)
        most = np.where(demand <= last - takeover.AGREED * reach, 0.0, np.inf)
        if transition.beyond is None:
            transition.beyond = 0.0 * demand if rests else np.clip(demand - required[0], least, most)
        low, high = self.model.limits_of_units(measurement.velocity.tolist())
        wanted = np.clip(required + transition.beyond, low, high)
        speeds = self.profile.at_times(effects)[1].reshape(-1, model.n_units)
        part = transition.early(last, wanted, speeds != 0.0, self.every)
        if not part.any():
            transition.beyond = None
        early = last + part * reach
        changed = np.where(part > 0.0, np.maximum(demand, early), np.minimum(demand, early))
        return [float(force) for force in np.where(part != 0.0, np.clip(changed, low, high), demand)]

    def _brakes_by_air(self) -> bool:
        """Return True if the air brake is demanded, or its shoes act."""
        if self.model.consist.air_brake is None:
            return False
        return self._shoes_act or self.pressure < self.model.consist.air_brake.charged  # type: ignore[operator]
