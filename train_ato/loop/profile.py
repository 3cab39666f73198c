"""Profile stage: the speed profile, its reference for every tick, and re-planning."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from train_ato.control.guard import is_valid_state
from train_ato.loop.headway import HeadwayProfile
from train_ato.loop.inputs import StageInputs
from train_ato.loop.stage_messages import ProfileMessages, ProfileStart
from train_ato.messages.delay_lines import MessageLink
from train_ato.messages.topics import Role
from train_ato.messages.types import AtoReport, AtoState, Diagnostic, Measurement, Reference, TrainAhead
from train_ato.profile.planner.plan_from_state import TrainState, replan
from train_ato.profile.planner.settings import PlanSettings
from train_ato.profile.profile import Profile, limits_of, trajectory_of
from train_ato.scenario.setup import RunSetup

if TYPE_CHECKING:
    from train_ato.profile.planner.replanner import ReplanDecision

REJOINED = "node profile restarted"
"""Reason of a profile that is sent again."""
BEHIND = "following a train"
"""State of a profile one headway behind the train ahead."""
MIN_ACCELERATION = 0.05
"""Smallest service limit of a plan [m/s²]."""
MIN_JERK, MAX_JERK = 1e-3, 0.5
"""Range of the jerk limit of a plan [m/s³]; the acceleration of another profile can have steps."""
RELEASED = 3.0
"""Time constants of the cylinders from the release wave at the last vehicle to released brakes; 5 % are left."""
FORCE_MARGIN = 0.2
"""Part of the force envelopes that a plan from standstill leaves to the law."""


class ProfileStage:
    """Operational speed profile, sent at the start and after re-planning, with its reference for every tick.

    Attributes
    ----------
    profile : Profile
        Current profile.
    planned : int
        Stamp of its planning [ns], 0 for the first; every reference contains it.
    headway : HeadwayProfile or None
        Profile behind the train ahead; None without one.
    answer : tuple of one ReplanDecision or None, optional
        Result of :meth:`decided` in a compiled tick that is left to Python, used in place of a second one.
    """

    role = Role.PROFILE

    def __init__(self, setup: RunSetup) -> None:
        self.setup = setup
        self.profile: Profile = setup.profile
        self.planned = 0
        self._replanner = setup.replanner()
        leader = setup.scenario.leader
        self.headway = None if leader is None or leader.headway is None else HeadwayProfile(setup)
        self.inputs = StageInputs(setup, self.role)
        self._link = MessageLink(setup.scenario.links.measurement, setup.step_ns, setup.scenario.seed, "measurement")
        self._decision: ReplanDecision | None = None
        self._counts = 0, 0
        self.answer: tuple[ReplanDecision | None] | None = None
        self.engaged, self._ready, air = True, 0, setup.model.consist.air_brake
        wave = 0.0 if air is None else setup.model.consist.length / air.release_wave
        self._release_time = 0.0 if air is None else wave + RELEASED * air.release_time
        self.joins = self._sent_again = False
        self._refusal = ""

    def join(self) -> None:
        """Join a run in progress, in place of an ended profile; an engaged ATO then has a new plan from its place.

        The profile of the scenario is in effect from the first reference on.
        """
        self.joins, self.engaged = True, False

    def start(self) -> ProfileStart:
        """Return the profile and the speed limits for latched topics."""
        return ProfileStart(trajectory_of(self.profile), limits_of(self.setup.line))

    def on_measurement(
        self, measurement: Measurement, ato: AtoReport | None = None, ahead: TrainAhead | None = None
    ) -> ProfileMessages:
        """Return the reference for the stamp of the measurement, with the new profile after re-planning.

        Parameters
        ----------
        measurement
            Measurement of this stamp.
        ato
            At a step of the supervisor: report of the ATO at the step before.
        ahead
            At a step of the supervisor: live report of the train ahead.
        """
        stamp = measurement.stamp
        arrived = self.inputs.measurement(measurement)
        report = None if ato is None else self.inputs.ends["ato/state"].receive(stamp, ato)
        decided, self.joins = self.joins, False
        if decided:  # the profile of the scenario is sent again, as that of the first reference
            self.planned, self._sent_again = stamp, True
        if not decided and report is not None and is_valid_state(arrived):
            decided = self._begun_again(stamp, arrived, report)
        if not decided and self.headway is not None and (behind := self.headway.step(stamp, ahead)) is not None:
            self.profile, self.planned, decided = behind, stamp, True
        answer, self.answer = self.answer, None
        (decision,) = (None,) if decided else self.decided(stamp, arrived) if answer is None else answer
        if decision is not None:
            self._decision, decided = decision, True
            if self._replanner is not None:  # the reports of compiled ticks are made after the next decision
                self._counts = self._replanner.replans, self._replanner.refusals
            if decision.profile is not None:
                self.profile, self.planned = decision.profile, stamp
        diagnostics = self.diagnostic(stamp) if self.inputs.report_due(stamp) or decided else None
        sent = trajectory_of(self.profile, stamp) if decided and self.planned == stamp else None
        return ProfileMessages(diagnostics, sent, Reference(stamp, *self.profile.at(stamp * 1e-9)[:3], self.planned))

    def _begun_again(self, stamp: int, measurement: Measurement, ato: AtoReport) -> bool:
        """Plan from standstill after the ATO was engaged again; return True after this decision."""
        before, self.engaged = self.engaged, bool(ato.state[0] == AtoState.ENGAGED)
        if not self.engaged and ato.state[0] != AtoState.READY:
            self._ready = stamp  # a brake acts up to this time, or the train moves
        if before or not self.engaged:
            return False
        self._sent_again = False
        setup = self.setup
        place, released = float(measurement.position[0] + setup.model.offsets[0]), self._ready * 1e-9
        state = TrainState(stamp * 1e-9, place, 0.0, released=released + self._release_time)
        settings = setup.scenario.profile.plan or _service_limits(setup.profile)
        try:
            rest = replan(state, setup.profile, setup.model.line, setup.model.consist, settings).profile
            self.profile, self.planned, self._refusal = self.profile.followed_by(rest), stamp, ""
            self.headway = None  # from here on a plan of its own, which the end of authority limits
            self._replanner, self._counts, self._decision = setup.replanner(self.profile), (0, 0), None
        except ValueError as error:
            self._refusal = str(error)
        return True

    def decided(self, stamp: int, measurement: Measurement) -> tuple[ReplanDecision | None]:
        """Return the decision on re-planning for a measurement, None without one."""
        if self._replanner is None or not self.engaged:
            return (None,)
        return (self._replanner.step(self._link.pass_on(stamp, measurement)),)

    def remaining(self, stamp: int) -> float:
        """Return the time to the end of the profile [s] at a stamp [ns]."""
        return max(0.0, self.profile.end - stamp * 1e-9)

    def diagnostic(self, stamp: int) -> Diagnostic:
        """Return the state of the profile, with the reason of re-planning or of its refusal."""
        profile, decision = self.profile, self._decision
        values = {"knots": str(profile.time.size), "period": repr(profile.period)}
        values["remaining"] = repr(self.remaining(stamp))
        values |= self.inputs.diagnostics()
        if self.headway is not None:
            return Diagnostic(stamp, "profile", 0, BEHIND, values | self.headway.receiver.diagnostics(stamp))
        if self._refusal:
            return Diagnostic(stamp, "profile", 1, "cannot be planned again", {**values, "reason": self._refusal})
        if self._sent_again and decision is None:
            return Diagnostic(stamp, "profile", 0, "following, sent again", {**values, "reason": REJOINED})
        if self.planned and decision is None:
            return Diagnostic(stamp, "profile", 0, "following, planned again", values)
        if self._replanner is None or decision is None:
            return Diagnostic(stamp, "profile", 0, "following", values)
        values |= {
            "planned": repr(self.planned * 1e-9),
            "replans": str(self._counts[0]),
            "refusals": str(self._counts[1]),
            "reason": decision.reason,
        }
        if decision.profile is None:
            return Diagnostic(stamp, "profile", 1, "cannot be planned again", values)
        return Diagnostic(stamp, "profile", 0, "following, planned again", values)


def _service_limits(profile: Profile) -> PlanSettings:
    """Return the settings of a plan with the largest accelerations and the jerk of a profile from another source."""
    jerk = float(np.abs(np.diff(profile.acceleration)).max(initial=0.0)) / profile.period
    return PlanSettings(
        jerk=min(max(jerk, MIN_JERK), MAX_JERK),
        acceleration=max(float(profile.acceleration.max()), MIN_ACCELERATION),
        deceleration=max(float(-profile.acceleration.min()), MIN_ACCELERATION),
        force_margin=FORCE_MARGIN,
    )
