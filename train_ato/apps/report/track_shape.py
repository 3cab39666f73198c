"""Grade, height, curves and tunnels of the part of a line used by a run."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plant_sim.line import Line
from plant_sim.track import Track
from train_ato.messages.types import Array


@dataclass(frozen=True)
class TrackShape:
    """Part of a line between two places.

    Attributes
    ----------
    place, grade : Array, shape (m,)
        Step function: places [km], grade from there on [‰], > 0 uphill; the last entry is the end.
    height : Array, shape (m,)
        Height above the first place [m].
    curves : list of (begin km, end km, radius m)
    tunnels : list of (begin km, end km)
    """

    place: Array
    grade: Array
    height: Array
    curves: list[tuple[float, float, float]]
    tunnels: list[tuple[float, float]]

    @property
    def is_plain(self) -> bool:
        """True for a level, straight line without tunnels."""
        return not (np.any(self.grade) or self.curves or self.tunnels)


def track_shape(line: Line, begin: float, end: float) -> TrackShape:
    """Return the part of a line between two places [m]."""
    track = Track(line)
    inside = track.breaks[(track.breaks > begin) & (track.breaks < end)]
    changes = np.diff(track.grade[np.searchsorted(track.breaks, inside, side="right")], prepend=np.nan) != 0
    place = np.concatenate(([begin], inside[changes], [end]))
    grade = track.grade[np.searchsorted(track.breaks, place, side="right")]
    grade[-1] = grade[-2]
    height = track.elevation(place)
    return TrackShape(
        place / 1e3,
        1e3 * grade,
        height - height[0],
        [
            (max(curve.begin, begin) / 1e3, min(curve.end, end) / 1e3, curve.radius)
            for curve in line.curves
            if curve.end > begin and curve.begin < end
        ],
        [
            (max(tunnel.begin, begin) / 1e3, min(tunnel.end, end) / 1e3)
            for tunnel in line.tunnels
            if tunnel.end > begin and tunnel.begin < end
        ],
    )
