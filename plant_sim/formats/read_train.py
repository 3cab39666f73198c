"""Train of a foreign file with the figures that the own consist file does not have."""

from __future__ import annotations

from dataclasses import dataclass

from plant_sim.consist import Consist


@dataclass(frozen=True, slots=True)
class ReadTrain:
    """Train of a foreign file, in SI; figures that the file does not have are None.

    Attributes
    ----------
    consist : Consist
        The train.
    deceleration, acceleration : float, optional
        Service deceleration and largest acceleration for comfort [m/s²].
    speed_max : float
        Largest speed [m/s].
    traction_efficiency, recovery_efficiency : float, optional
        Wheel energy over line energy in traction, recovered line energy over wheel energy in braking.
    """

    consist: Consist
    deceleration: float | None
    speed_max: float
    acceleration: float | None = None
    traction_efficiency: float | None = None
    recovery_efficiency: float | None = None
