"""A copy of the whole nominal train, with ideal actuators, for compensations that let one run ahead."""

from __future__ import annotations

from typing import TYPE_CHECKING

from plant_sim.plant_setup import PlantSetup
from plant_sim.train import Train

if TYPE_CHECKING:
    from train_ato.compensate.rigid import ProfileLike
    from train_ato.model import TrainModel


def nominal_copy(model: TrainModel, profile: ProfileLike, t: float, period: float, step: float) -> Train:
    """Return the model's train on its profile.

    Parameters
    ----------
    model
        The nominal train and line.
    profile
        Where it is and how fast.
    t
        Time at which it is there [s].
    period
        Of its commands [s].
    step
        Integration step that is wanted [s]; the nearest that divides the period and is not much shorter.
    """
    place, speed, _, _ = profile.at(t)
    tick_ns = round(period * 1e9)
    most = max(1, round(period / step))
    step_ns = next(tick_ns // count for count in range(most, 0, -1) if tick_ns % count == 0)
    setup = PlantSetup.model_validate({"start": {"position": place, "speed": speed}})
    return Train(model.consist, model.line, setup, step_ns, tick_ns)
