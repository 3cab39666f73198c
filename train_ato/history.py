"""Series of a run at the tick: from the engine's memory or from a log, the same numbers either way."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from train_ato.changes import Told
from train_ato.run_setup import RunSetup
from train_ato.types import Array, Diagnostic

SERIES = (
    "train/cars",
    "train/measurement",
    "train/brake_pipe",
    "train/brake_cylinders",
    "train/disturbance",
    "ato/reference",
    "ato/command",
    "ato/estimate",
    "/diagnostics",
)
"""Topics that the series are made of."""

COUNTED = {"profile": ("replans",), "controller": ("held_steps", "unsound_measurements")}
"""What is taken from the diagnostics of a node, its latest value."""


@dataclass(frozen=True)
class History:
    """Series of a run; k ticks, u power units.

    Attributes
    ----------
    time : Array, shape (k,)
        Simulation time [s].
    position, velocity : Array, shape (k, u)
        Truth of every power unit [m, m/s].
    front_position, front_velocity : Array, shape (k,)
        Truth of vehicle 0's centre.
    coupler_high, coupler_low : Array, shape (k,)
        Largest draft and buff (negative) force along the train at the tick [N].
    coupler_some : Array, shape (k, 3)
        Force behind the first, the middle and the last but one vehicle [N].
    applied, command, estimate : Array, shape (k, u)
        Measured applied force, command as sent, disturbance estimate [N].
    reference_position, reference_velocity, reference_acceleration : Array, shape (k,)
        Reference of vehicle 0's centre.
    disturbance : Array, shape (k, u)
        True outside force on every power unit's vehicle [N]; zeros where the scenario has none.
    final_position, final_velocity : float
        Vehicle 0 after the last tick.
    totals : dict
        Running totals of the plant at the end, from its diagnostics, and what the profile and the controller count.
    brake_pipe, shoe_force : Array, shape (k,), or None
        Pressure at the head [Pa, absolute] and shoe force of the whole train [N]; None without an air brake.
    """

    time: Array
    position: Array
    velocity: Array
    front_position: Array
    front_velocity: Array
    coupler_high: Array
    coupler_low: Array
    coupler_some: Array
    applied: Array
    command: Array
    estimate: Array
    disturbance: Array
    reference_position: Array
    reference_velocity: Array
    reference_acceleration: Array
    final_position: float
    final_velocity: float
    totals: dict[str, float]
    brake_pipe: Array | None = None
    shoe_force: Array | None = None


@dataclass
class HistoryBuilder:
    """Collects messages of one run, in any order of topics, and makes the series of the ticks that are complete.

    Attributes
    ----------
    told : Told
        What was changed while the run went on.
    """

    setup: RunSetup
    _rows: dict[str, list[Any]] = field(default_factory=dict)
    _totals: dict[str, str] = field(default_factory=dict)
    _counts: dict[str, str] = field(default_factory=dict)
    _disturbance: list[Array] = field(default_factory=list)
    _pipe: list[float] = field(default_factory=list)
    _shoes: list[float] = field(default_factory=list)
    told: Told = field(default_factory=Told)

    def __post_init__(self) -> None:
        self._rows = {name: [] for name in ("cars", "measurement", "reference", "command", "estimate")}
        self._units = np.array(self.setup.model.units, dtype=np.intp)
        n = self.setup.shape.n_vehicles
        self._some = np.array([0, max(0, (n - 1) // 2), max(0, n - 2)], dtype=np.intp)

    def add(self, topic: str, message: Any) -> None:
        """Take one message; topics without a series are ignored."""
        if topic == "train/cars":
            force = message.coupler_force
            self._rows["cars"].append(
                (
                    message.stamp,
                    message.position[self._units],
                    message.velocity[self._units],
                    message.position[0],
                    message.velocity[0],
                    force.max(),
                    force.min(),
                    force[self._some],
                )
            )
        elif topic == "train/measurement":
            self._rows["measurement"].append(message.applied)
        elif topic == "ato/reference":
            self._rows["reference"].append((message.position, message.velocity, message.acceleration))
        elif topic == "ato/command":
            self._rows["command"].append(message.force)
        elif topic == "ato/estimate":
            self._rows["estimate"].append(message.force)
        elif topic == "train/disturbance":
            self._disturbance.append(message.force[self._units])
        elif topic == "train/brake_pipe":
            self._pipe.append(message.pressure)
        elif topic == "train/brake_cylinders":
            self._shoes.append(float(message.shoe_force.sum()))
        elif topic == "/diagnostics":
            self._told(message)

    def _told(self, message: Diagnostic) -> None:
        """Take the running totals, the counts and the changes that a node tells of."""
        if message.node == "plant":
            self._totals = message.values
        elif message.node in COUNTED:
            self._counts |= {key: message.values[key] for key in COUNTED[message.node] if key in message.values}
        self.told.take(message)

    def complete_ticks(self) -> int:
        """Return the number of ticks that have every series."""
        return min(len(rows) for rows in self._rows.values())

    def finish(self) -> History:
        """Return the series of every tick that has a command.

        Raises
        ------
        ValueError
            If not a single tick is complete.
        """
        rows, count = self._rows, self.complete_ticks()
        if count == 0:
            raise ValueError("the run holds no complete tick")
        cars = rows["cars"][:count]
        reference = np.array(rows["reference"][:count], dtype=np.float64)
        columns = list(zip(*cars, strict=True))
        totals = {**self._totals, **self._counts}
        final = rows["cars"][count] if len(rows["cars"]) > count else rows["cars"][count - 1]
        return History(
            time=np.array(columns[0], dtype=np.float64) * 1e-9,
            position=np.array(columns[1]),
            velocity=np.array(columns[2]),
            front_position=np.array(columns[3]),
            front_velocity=np.array(columns[4]),
            coupler_high=np.array(columns[5]),
            coupler_low=np.array(columns[6]),
            coupler_some=np.array(columns[7]),
            applied=np.array(rows["measurement"][:count]),
            command=np.array(rows["command"][:count]),
            estimate=np.array(rows["estimate"][:count]),
            disturbance=np.array(self._disturbance[:count])
            if self._disturbance
            else np.zeros((count, self._units.size)),
            reference_position=reference[:, 0],
            reference_velocity=reference[:, 1],
            reference_acceleration=reference[:, 2],
            final_position=float(final[3]),
            final_velocity=float(final[4]),
            totals={name: float(text) for name, text in totals.items() if _is_number(text)},
            brake_pipe=np.array(self._pipe[:count]) if len(self._pipe) >= count else None,
            shoe_force=np.array(self._shoes[:count]) if len(self._shoes) >= count else None,
        )


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
