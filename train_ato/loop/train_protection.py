"""Fail-safe reactions of the train: which demands reach drives and brakes.

The highest demand of these sources is in effect:

* the supervisor, by its brake release, and the absence of a recent one;
* the age of the newest command of the ATO;
* an emergency brake requested by an intervention;
* a train separation.
"""

from dataclasses import dataclass
from operator import itemgetter

import numpy as np

from plant_sim.compiled import compiled
from plant_sim.record import Records, quantity, zeros
from train_ato.messages.delay_lines import DelayJump, DelayLine, Link, MessageLink, Stamps, UnitQueue, arrive
from train_ato.messages.types import Array, BrakeRelease, Protection
from train_ato.scenario.setup import RunSetup

REQUESTED, SUPERVISOR = "emergency brake requested", "supervisor"
"""Reasons of a reaction: an intervention, and the brake release of the supervisor."""


@dataclass
class CommandAge:
    """Age of the newest command that has arrived at the train."""

    newest: int = quantity("ns", "stamp of the command")
    nominal: int = quantity("ns", "age of a command in time")
    shortest: int = quantity("ns", "largest age beyond the nominal one without a reaction")


@compiled
def command_age(
    ages: Records[CommandAge], lines: Records[DelayLine], units: Records[UnitQueue], due: Stamps, value: Array,
    stamp: int, arrived: Array,
) -> int:  # fmt: skip
    """Return the age beyond the nominal one of the newest command at a stamp [ns].

    The link has the stamps of the commands as values; ``arrived`` has the place for the newest, shape (1, 1).
    """
    age = ages[0]
    arrive(lines, units, due, value, stamp, arrived)
    age.newest = max(age.newest, int(arrived[0, 0]))
    return stamp - age.newest - age.nominal


class TrainProtection:
    """Reaction of the train at every tick.

    Parameters
    ----------
    setup
        Prepared run; without supervision only the requested emergency brake acts.

    Attributes
    ----------
    level : Protection
        Reaction in effect.
    reason : str
        Reason of the reaction, "" without one.
    awaits_standstill : bool
        True while a missing message keeps the emergency brake on; only then :meth:`step` depends on standstill.
    requested : bool
        True if an intervention has applied the emergency brake.
    stamps : Link
        Link of the commands, with their stamps as values.
    age : Records of CommandAge
        Age of the newest command.
    """

    def __init__(self, setup: RunSetup) -> None:
        self.level = Protection.NONE
        self.reason = ""
        self.requested = False
        self._supervised = setup.layout.supervised
        spec, links, seed = setup.scenario.supervision.failsafe, setup.scenario.links, setup.scenario.seed
        link, release = links.command, links.brake_release
        self.stamps, self._arrived = Link(link.newest(), 1, setup.step_ns, seed, "command"), np.zeros((1, 1))
        self.age = zeros(CommandAge, 1)
        self._bounds = tuple(round(bound * 1e9) for bound in (spec.hold, spec.coast, spec.service))
        self._shortest = min(self._bounds)
        self.age["nominal"], self.age["shortest"] = round(link.longest * 1e9) + setup.tick_ns, self._shortest
        self._release_link = MessageLink(release, setup.step_ns, seed, "brake_release")
        allowed = (setup.supervision_ticks + 1) * setup.tick_ns if spec.release is None else round(spec.release * 1e9)
        self._release_age = allowed + round(release.longest * 1e9)
        self._release: BrakeRelease | None = None
        self._decision = Protection.NONE
        self._lost = ""
        self._silent = Protection.NONE
        self._unreleased = self.awaits_standstill = False

    def jump(self, change: DelayJump) -> None:
        """Add a change of the command delays."""
        self.stamps.jump(change)

    def lose(self, reason: str) -> None:
        """Apply the service brake from the next step on, because a node has ended and does not return."""
        self._lost = reason

    def on_command(self, stamp: int, received: int | None = None) -> None:
        """Take the stamp of a command of the ATO and the time of its reception [ns], by default its stamp."""
        if self._supervised:
            self.stamps.push(stamp if received is None else received, (float(stamp),))

    def on_release(self, release: BrakeRelease, received: int | None = None) -> None:
        """Take a brake release of the supervisor and the time of its reception [ns], by default its stamp."""
        self._release = self._release_link.pass_on(release.stamp if received is None else received, release)
        self._decision = _decision(self._release)

    def is_idle(self, stamp: int, period_ns: int) -> bool:
        """Return True if only a late command makes a reaction in the ticks from a stamp [ns] on.

        The brakes stay released then, and a release arrives after every period [ns].
        """
        release = self._release
        if release is None or not self._release_link.is_idle or self._lost or self._unreleased:
            return False
        if self._silent is not Protection.NONE or self._decision is not Protection.NONE:
            return False
        return max(stamp - release.stamp, period_ns) <= min(period_ns, self._release_age)

    def step(self, stamp: int, *, standstill: bool, separated: bool = False) -> Protection:
        """Return the reaction of the tick at ``stamp`` [ns].

        Parameters
        ----------
        stamp
            Time [ns].
        standstill
            True if the train is at standstill; it ends the emergency brake of a missing message.
        separated
            True if the head of the train has the emergency brake because of a train separation.
        """
        demands = [(Protection.EMERGENCY_BRAKE, REQUESTED) if self.requested else (Protection.NONE, "")]
        if self._supervised:
            if separated:
                demands.append((Protection.EMERGENCY_BRAKE, "train separation"))
            if self._lost:
                demands.append((Protection.SERVICE_BRAKE, self._lost))
            demands.append(self._of_release(stamp, standstill=standstill))
            demands.append(self._of_command(stamp, standstill=standstill))
            self.awaits_standstill = self._unreleased or self._silent is Protection.EMERGENCY_BRAKE
        self.level, self.reason = max(demands, key=itemgetter(0))  # of equal ones the first
        return self.level

    def _of_release(self, stamp: int, *, standstill: bool) -> tuple[Protection, str]:
        """Return the reaction to the brake release of the supervisor or to its age.

        The emergency brake of a missing release lasts until standstill.
        """
        age = stamp - (0 if self._release is None else self._release.stamp)
        if age > self._release_age or (self._unreleased and not standstill):
            self._unreleased = True
            return Protection.EMERGENCY_BRAKE, f"no brake release for {age * 1e-9:.1f} s"
        self._unreleased = False
        return self._decision, "" if self._decision is Protection.NONE else SUPERVISOR

    def _of_command(self, stamp: int, *, standstill: bool) -> tuple[Protection, str]:
        """Return the reaction to the age of the newest command; an emergency brake lasts until standstill."""
        age = int(command_age(self.age, *self.stamps.records(stamp, 0), stamp, self._arrived))
        emergency = self._silent is Protection.EMERGENCY_BRAKE and not standstill
        if age <= self._shortest and not emergency:
            self._silent = Protection.NONE
            return Protection.NONE, ""
        late = Protection(sum(age > bound for bound in self._bounds))
        self._silent = Protection.EMERGENCY_BRAKE if emergency else late
        return self._silent, f"no command for {(stamp - int(self.age['newest'][0])) * 1e-9:.1f} s"


def _decision(release: BrakeRelease) -> Protection:
    """Return the reaction that a brake release demands; only the exact value releases."""
    traction, service, emergency = release.released.tolist()
    if emergency != 1.0:
        return Protection.EMERGENCY_BRAKE
    if service != 1.0:
        return Protection.SERVICE_BRAKE
    return Protection.NONE if traction == 1.0 else Protection.COAST
