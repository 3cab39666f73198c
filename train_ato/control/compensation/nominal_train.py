"""Simulated copy of the nominal train with ideal actuators, for compensations that run it ahead of the real one."""

from __future__ import annotations

from typing import TYPE_CHECKING

from plant_sim.plant_setup import PlantSetup
from plant_sim.train import Train

if TYPE_CHECKING:
    from train_ato.control.compensation.rigid import ProfileLike
    from train_ato.control.train_model import TrainModel


def nominal_copy(model: TrainModel, profile: ProfileLike, t: float, period: float, step: float) -> Train:
    """Return a train on the profile, couplers unstretched, with ideal actuators.

    Parameters
    ----------
    model
        The nominal train and line.
    profile
        Profile that gives position and speed.
    t
        Time of the initial state on the profile [s].
    period
        Period of the commands [s].
    step
        Smallest integration step [s]; the step used is the next longer one that divides the period.
    """
    place, speed, _, _ = profile.at(t)
    tick_ns = round(period * 1e9)
    most = max(1, round(period / step))
    step_ns = next(tick_ns // count for count in range(most, 0, -1) if tick_ns % count == 0)
    setup = PlantSetup.model_validate({"start": {"position": place, "speed": speed}})
    return Train(model.consist, model.line, setup, step_ns=step_ns, tick_ns=tick_ns)
