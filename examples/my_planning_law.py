"""Template of a law that looks ahead: limits of the line, disturbance, couplers and a plan for the log.

The law gains a part of the speed that it will lose where the force ahead is too small, as in a neutral section::

    train-ato check-law my_planning_law:MyPlanningLaw
    train-ato run crh380a_gpc:short --law my_planning_law:MyPlanningLaw --compensation preview
    train-ato run demo --law my_planning_law:MyPlanningLaw
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from train_ato.control.contract import LawInput, LawPlan, parameter
from train_ato.control.guard import GuardedLaw
from train_ato.control.mpc.coupler_limit import CouplerLimit

STEP = 0.5
"""Time from one entry of the lookahead to the next [s]."""


@dataclass
class MyPlanningLaw(GuardedLaw):
    """Feed-forward, two gains, and speed gained before a shortage of force (template)."""

    gain: float = parameter(0.05, "1/s", 0.0, 10.0, "gain on the speed error, times the inertia of the train")
    stiffness: float = parameter(0.0006, "1/s²", 0.0, 10.0, "gain on the position error, times the inertia")
    gained: float = parameter(0.5, "1", 0.0, 1.0, "part of the lost speed that is gained before the loss")
    coupler_limit: float = parameter(500e3, "N", 1e3, 1e8, "largest coupler force of a train without waves")

    def bind(self, model: Any, period: float) -> None:
        """Take the train, its couplers and line, and the control period [s]."""
        super().bind(model, period)
        self.lookahead_times = STEP * np.arange(61)
        self.couplers = CouplerLimit(model, self.coupler_limit)
        self.clear_state()

    def clear_state(self) -> None:
        """Discard the last plan."""
        self.last: LawPlan | None = None

    def planned(self) -> LawPlan | None:
        """Return the plan of the last demand, for the log and the live page."""
        return self.last

    def demand(self, inputs: LawInput) -> list[float]:
        """Return the force demand of every unit [N]; GuardedLaw checks the inputs and limits the output."""
        ahead, inertia = inputs.lookahead, self.model.inertia
        needed = inertia * ahead.acceleration + ahead.resistance
        force = np.minimum(needed, ahead.force_max.sum(axis=1))
        lost = np.cumsum(needed - force) * STEP / inertia
        faster = min(self.gained * float(lost[-1]), float(ahead.speed_limit[0] - ahead.velocity[0]))
        self.last = LawPlan(
            self.lookahead_times, ahead.position, ahead.velocity + faster - lost, force, np.zeros(lost.size), "solved"
        )
        speed_error = inputs.velocity - inputs.reference_velocity - max(faster, 0.0)
        pull = self.gain * speed_error + self.stiffness * (inputs.position - inputs.reference_position)
        wanted = inputs.feedforward - inputs.disturbance - inertia * self.model.share * pull
        low, high = self.couplers.force_range(ahead.position[:1], ahead.velocity[:1])[:, 0]
        total = float(wanted.sum())
        demanded: list[float] = (wanted + (min(max(total, low), high) - total) * self.model.share).tolist()
        return demanded
