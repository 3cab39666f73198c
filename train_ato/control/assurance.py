"""Run-time assurance: a plain braking law takes over from the law before the warning limit (Simplex architecture).

The law drives as long as the speed predicted over the reaction time stays below the warning limit, or below that of the
service brake.  Otherwise the full service brake acts until the speed is below the permitted speed by a margin.  Its
jerk is limited only as far as the distance to the intervention of the supervisor allows.
"""

# mypy: no-warn-return-any

from dataclasses import dataclass
from typing import Any

from plant_sim.compiled import compiled
from plant_sim.record import Records, quantity, zeros
from plant_sim.units import KMH
from train_ato.messages.types import SupervisedSpeeds
from train_ato.supervision.odometry import PastSpeed, add_speed, past_speeds
from train_ato.supervision.settings import SupervisionSpec
from train_ato.supervision.step_function import SupervisionSpeeds

BRAKING_LAW = "braking law"
"""State of the controller in its diagnostics while the braking law drives."""
AT_ONCE = 1e6
"""Jerk of a brake without a ramp [m/s³]."""


@dataclass
class AssuranceConstants:
    """Settings of the run-time assurance."""

    reaction: float = quantity("s", "time from the decision to the effect of the brake")
    margin: float = quantity("m/s", "distance from the permitted speed at which the law drives again")
    up_to_service: bool = quantity("", "the limit is that of the service brake, not the warning")


@dataclass
class AssuranceState:
    """State of the run-time assurance, and the numbers of its newest takeover."""

    brakes: bool = quantity("", "the braking law drives")
    takeovers: int = quantity("", "number of takeovers by the braking law")
    stamp: int = quantity("ns", "time of the newest step")
    service_limit: float = quantity("m/s", "limit of the service brake at the newest step")
    least_jerk: float = quantity("m/s³", "jerk with which the speed stays below the limit of the service brake")
    reason_speed: float = quantity("m/s", "speed at the takeover")
    reason_front: float = quantity("m", "front position at the takeover")
    reason_predicted: float = quantity("m/s", "predicted speed at the takeover")
    reason_limit: float = quantity("m/s", "limit at the takeover")
    first: int = quantity("", "first speed of the average")
    count: int = quantity("", "number of its speeds")


@compiled
def ramp_jerk(p: AssuranceConstants, rest: float, approach: float) -> float:
    """Return the jerk that keeps a speed below the limit of the service brake [m/s³].

    Their difference [m/s] shrinks at the rate of the approach [m/s²]: by approach x reaction before the brake has an
    effect, and by approach² / (2 jerk) in its ramp.
    """
    if approach <= 0.0:
        return 0.0
    left = rest - approach * p.reaction
    return min(approach**2 / (2.0 * left), AT_ONCE) if left > 0.0 else AT_ONCE


@compiled
def assure(
    p: AssuranceConstants, own: AssuranceState, past: Records[PastSpeed], stamp: int, front: float, speed: float,
    speeds: SupervisionSpeeds,
) -> bool:  # fmt: skip
    """Choose between the law and the braking law at a step of the supervisor; return True after a change."""
    since = (stamp - own.stamp) * 1e-9 if own.count > 0 else 0.0
    fall = (own.service_limit - speeds.service) / since if since > 0.0 else 0.0
    own.service_limit, own.stamp = speeds.service, stamp
    before = add_speed(own, past, stamp, speed)
    span, slower = (stamp - before.stamp) * 1e-9, before.speed
    predicted = speed + (speed - slower) * (p.reaction / span if span > 0.0 else 0.0)
    limit, was = speeds.service if p.up_to_service else speeds.warning, own.brakes
    if not was and speed > 0.0 and max(speed, predicted) >= limit:
        own.brakes = True
        own.takeovers += 1
        rate = (speed - slower) / span if span > 0.0 else 0.0
        own.least_jerk = ramp_jerk(p, own.service_limit - speed, fall + rate)
        own.reason_speed, own.reason_front = speed, front
        own.reason_predicted, own.reason_limit = predicted, limit
    elif was and (speed <= 0.0 or max(speed, predicted) < speeds.permitted - p.margin):
        own.brakes = False
    return bool(own.brakes != was)


@compiled
def _assure(
    p: Any, own: Any, past: Any, stamp: int, front: float, speed: float, permitted: float, warning: float,
    service: float, emergency: float,
) -> bool:  # fmt: skip
    limits = SupervisionSpeeds(permitted, warning, service, emergency)
    return assure(p[0], own[0], past, stamp, front, speed, limits)


class AssuranceMonitor:
    """Decision between the law and the braking law at every step of the supervisor.

    Parameters
    ----------
    reaction
        Time from the decision to the effect of the brake [s].
    spec
        Limit, and distance from the permitted speed at which the law drives again.

    Attributes
    ----------
    constants, state : Array of :class:`AssuranceConstants` and of :class:`AssuranceState`, shape (1,)
        Settings and state.
    past : Array of :class:`train_ato.supervision.odometry.PastSpeed`
        Speeds of the averaged acceleration.
    """

    def __init__(self, reaction: float, spec: SupervisionSpec) -> None:
        self.constants, self.state, self.past = zeros(AssuranceConstants, 1), zeros(AssuranceState, 1), past_speeds()
        self.constants["reaction"], self.constants["margin"] = reaction, spec.assurance_margin
        self.constants["up_to_service"] = spec.assurance_limit != "warning"

    def step(self, speeds: SupervisedSpeeds) -> bool:
        """Return True after a change between the law and the braking law."""
        front, numbers = float(speeds.position[0]), speeds.speed.tolist()
        return bool(_assure(self.constants, self.state, self.past, speeds.stamp, front, *numbers))

    @property
    def brakes(self) -> bool:
        """True while the braking law drives."""
        return bool(self.state["brakes"][0])

    @property
    def takeovers(self) -> int:
        """Number of takeovers by the braking law."""
        return int(self.state["takeovers"][0])

    @property
    def least_jerk(self) -> float:
        """Jerk of the newest takeover with which the speed stays below the limit of the service brake [m/s³]."""
        return float(self.state["least_jerk"][0])

    @property
    def reason(self) -> str:
        """Speed, place and limit of the newest takeover."""
        own = self.state[0]
        return (
            f"{KMH * own['reason_speed']:.1f} km/h at {own['reason_front']:.0f} m, predicted "
            f"{KMH * own['reason_predicted']:.1f} km/h, limit {KMH * own['reason_limit']:.1f} km/h"
        )
