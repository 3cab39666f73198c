"""Law that sees the moving end of authority, for the tests of following trains."""

import math

import numpy as np

from train_ato.control.contract import LawInput
from train_ato.control.guard import GuardedLaw


class SeesTheEnd(GuardedLaw):
    """A law that brakes for the moving end of authority, at 0.25 m/s² and 10 s early, 20 m before it."""

    lookahead_times = np.array([0.0, 5.0])

    def __init__(self, *, sees: bool = True) -> None:
        self.sees, self.seen = sees, list[tuple[float, ...]]()

    def demand(self, inputs: LawInput) -> list[float]:
        """Return the force that keeps the speed of the reference, or the lower one before the end [N]."""
        ahead, place, speed = inputs.lookahead, float(inputs.position[0]), float(inputs.velocity[0])
        self.seen.append((inputs.t, ahead.position_max, *ahead.position.tolist(), *ahead.speed_limit.tolist()))
        left = max(ahead.position_max - place - 20.0, 0.0) if self.sees else math.inf
        target = min(float(inputs.reference_velocity[0]), -2.5 + math.sqrt(6.25 + 0.5 * left))
        return [share * self.model.inertia * 0.5 * (target - speed) for share in self.share]
