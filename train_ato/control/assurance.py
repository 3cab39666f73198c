"""Run-time assurance: a plain braking law takes over from the law before the warning limit (Simplex architecture).

The law drives as long as the speed predicted over the reaction time stays below the warning limit, or below that of the
service brake.  Otherwise the full service brake acts until the speed is below the permitted speed by a margin.  Its
jerk is limited only as far as the distance to the intervention of the supervisor allows.
"""

from __future__ import annotations

from collections import deque

from plant_sim.units import KMH
from train_ato.messages.types import SupervisedSpeeds
from train_ato.supervision.settings import SupervisionSpec

BRAKING_LAW = "braking law"
"""State of the controller in its diagnostics while the braking law drives."""
RATE_TIME = 1.2
"""Time over which the acceleration is averaged [s]; vibrations of a long train are shorter."""
AT_ONCE = 1e6
"""Jerk of a brake without a ramp [m/s³]."""
_ESTIMATE, _PERMITTED, _WARNING, _SERVICE = range(4)


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
    brakes : bool
        True while the braking law drives.
    takeovers : int
        Number of takeovers by the braking law.
    service_limit : float
        Limit of the service brake at the newest step [m/s].
    least_jerk : float
        Jerk of the newest takeover with which the speed remains below the limit of the service brake [m/s³].
    reason : str
        Speed, place and limit of the newest takeover; "" before the first.
    """

    def __init__(self, reaction: float, spec: SupervisionSpec) -> None:
        self._reaction, self._margin = reaction, spec.assurance_margin
        self._limit = _WARNING if spec.assurance_limit == "warning" else _SERVICE
        self._past: deque[tuple[int, float]] = deque()
        self.brakes = False
        self.takeovers = 0
        self.least_jerk = self.service_limit = 0.0
        self.reason = ""

    def step(self, speeds: SupervisedSpeeds) -> bool:
        """Return True after a change between the law and the braking law."""
        values = speeds.speed.tolist()
        speed, permitted, limit = values[_ESTIMATE], values[_PERMITTED], values[self._limit]
        since = (speeds.stamp - self._past[-1][0]) * 1e-9 if self._past else 0.0
        fall = (self.service_limit - values[_SERVICE]) / since if since > 0.0 else 0.0
        self.service_limit = values[_SERVICE]
        self._past.append((speeds.stamp, speed))
        while len(self._past) > 2 and speeds.stamp - self._past[1][0] >= RATE_TIME * 1e9:
            self._past.popleft()
        before, slower = self._past[0]
        span = (speeds.stamp - before) * 1e-9
        share = self._reaction / span if span > 0.0 else 0.0
        predicted = speed + (speed - slower) * share
        was = self.brakes
        if not was and speed > 0.0 and max(speed, predicted) >= limit:
            self.brakes = True
            self.takeovers += 1
            self.least_jerk = self._least_jerk(speed, fall + ((speed - slower) / span if span > 0.0 else 0.0))
            self.reason = (
                f"{KMH * speed:.1f} km/h at {float(speeds.position[0]):.0f} m, predicted {KMH * predicted:.1f} km/h, "
                f"limit {KMH * limit:.1f} km/h"
            )
        elif was and (speed <= 0.0 or max(speed, predicted) < permitted - self._margin):
            self.brakes = False
        return self.brakes is not was

    def _least_jerk(self, speed: float, approach: float) -> float:
        """Return the jerk that keeps a speed below the limit of the service brake [m/s³].

        Their difference shrinks at the rate of the approach [m/s²]: by approach x reaction before the brake has an
        effect, and by approach² / (2 jerk) in its ramp.
        """
        if approach <= 0.0:
            return 0.0
        rest = self.service_limit - speed - approach * self._reaction
        return min(approach**2 / (2.0 * rest), AT_ONCE) if rest > 0.0 else AT_ONCE
