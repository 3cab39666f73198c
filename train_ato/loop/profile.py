"""The operational speed profile, its reference for every step, and planning it again."""

from __future__ import annotations

from typing import TYPE_CHECKING

from train_ato.links import MessageLink
from train_ato.profile.profile import Profile
from train_ato.roles.outgoing import Outgoing, due
from train_ato.roles.trajectories import limits_of, trajectory_of
from train_ato.run_setup import RunSetup
from train_ato.topics import Role
from train_ato.types import (
    Diagnostic,
    Measurement,
    Reference,
)

if TYPE_CHECKING:
    from train_ato.plan.remaining import Decision


class ProfileRole:
    """The operational speed profile: sent once, again when it was planned anew, and its reference for every step.

    Attributes
    ----------
    profile : Profile
        The one in force.
    planned : int
        Stamp at which it was planned [ns], 0 for the first; every reference names it.
    """

    role = Role.PROFILE

    def __init__(self, setup: RunSetup) -> None:
        self.setup = setup
        self.profile: Profile = setup.profile
        self.planned = 0
        self._replanner = setup.replanner()
        self._link = MessageLink(setup.links.measurement, setup.step_ns, setup.seed, "measurement")
        self._decision: Decision | None = None

    def start(self) -> Outgoing:
        """Return the profile and the speed limits, to be latched."""
        return [("ato/profile", trajectory_of(self.profile)), ("ato/limits", limits_of(self.setup))]

    def step(self, stamp: int) -> Reference:
        """Return the reference at ``stamp`` [ns]."""
        position, velocity, acceleration, _ = self.profile.at(stamp * 1e-9)
        return Reference(stamp, position, velocity, acceleration, self.planned)

    def answer(self, measurement: Measurement) -> Outgoing:
        """Return what to send for a measurement: a profile planned anew before ``ato/reference``, which comes last."""
        stamp = measurement.stamp
        messages: Outgoing = []
        decided = self._replanned(measurement)
        if decided or due(stamp, self.setup.tick_ns):
            messages.append(("/diagnostics", self.diagnostic(stamp)))
        if decided and self.planned == stamp:
            messages.append(("ato/profile", trajectory_of(self.profile, stamp)))
        messages.append(("ato/reference", self.step(stamp)))
        return messages

    def _replanned(self, measurement: Measurement) -> bool:
        """Look whether the profile can be followed; tell whether a decision fell."""
        if self._replanner is None:
            return False
        decision = self._replanner.step(self._link.pass_on(measurement.stamp, measurement))
        if decision is None:
            return False
        self._decision = decision
        if decision.profile is not None:
            self.profile, self.planned = decision.profile, measurement.stamp
        return True

    def diagnostic(self, stamp: int) -> Diagnostic:
        """Return what is followed, and why it was planned anew or could not be."""
        profile, replanner, decision = self.profile, self._replanner, self._decision
        remaining = max(0.0, profile.end - stamp * 1e-9)
        values = {"knots": str(profile.time.size), "period": repr(profile.period), "remaining": repr(remaining)}
        if replanner is None or decision is None:
            return Diagnostic(stamp, "profile", 0, "following", values)
        values |= {
            "planned": repr(self.planned * 1e-9),
            "replans": str(replanner.replans),
            "refusals": str(replanner.refusals),
            "reason": decision.reason,
        }
        if decision.profile is None:
            return Diagnostic(stamp, "profile", 1, "cannot be planned again", values)
        return Diagnostic(stamp, "profile", 0, "following, planned again", values)
