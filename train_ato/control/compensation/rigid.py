"""Force of the rigid nominal train along the profile, computed once per profile."""

import numpy as np

from plant_sim.compiled import compiled
from plant_sim.railway import between_entries, each_between_entries
from train_ato.control.contract import ProfileLike
from train_ato.control.train_model import TrainModel
from train_ato.messages.types import Array


@compiled
def demand_ahead(table: Array, begin: float, spacing: float, lag: float, t: float) -> float:
    """Return the demand F + lag F' [N] that gives the force F of a table at a time [s] through a first-order lag [s].

    Parameters
    ----------
    table : Array, shape (times,)
        Force along the profile [N].
    begin, spacing
        Time of the first entry, and time between entries [s].
    lag, t
        s.
    """
    force = float(between_entries(table, (t - begin) / spacing))
    if lag <= 0.0:
        return force
    h = 0.5 * spacing
    after, before = between_entries(table, (t + h - begin) / spacing), between_entries(table, (t - h - begin) / spacing)
    return float(force + lag * ((after - before) / spacing))


class RigidForce:
    """Total force of the nominal train along a profile, without the air brake.

    Attributes
    ----------
    forces, resisting : Array, shape (knots,)
        Total force, and running plus line resistance in it, at the knots of the profile [N].
    begin, spacing : float
        Time of the first knot, and time between knots [s].
    """

    def __init__(self, model: TrainModel, profile: ProfileLike) -> None:
        self.model = model
        self.profile = profile
        self.resisting: Array = model.resisting_forces(profile.position, profile.velocity)
        self.forces: Array = model.inertia * profile.acceleration + self.resisting
        self.begin = float(profile.time[0])
        last = self.forces.size - 1
        self.spacing = float(profile.time[-1] - profile.time[0]) / last if last else 1.0

    def aheads(self, t: Array, lag: float) -> Array:
        """Return :meth:`ahead` at many times [s] in N, shape (times,)."""
        force, after, before = (
            each_between_entries(self.forces, (t + shift - self.begin) / self.spacing)
            for shift in (0.0, 0.5 * self.spacing, -0.5 * self.spacing)
        )
        return np.asarray(force + lag * ((after - before) / self.spacing))

    def resistances(self, t: Array) -> Array:
        """Return running and line resistance at many times [s] in N."""
        return np.asarray(each_between_entries(self.resisting, (t - self.begin) / self.spacing))

    def ahead(self, t: float, lag: float = 0.0) -> float:
        """Return the demand F + lag F' that gives the force F at a time [s] through a first-order lag [s], in N."""
        return float(demand_ahead(self.forces, self.begin, self.spacing, lag, t))
