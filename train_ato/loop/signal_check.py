"""Signals that only some runs have, checked before the run."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from plant_sim.line import Line
from train_ato.messages.layout import TrainLayout
from train_ato.scenario.signals import find_signal

__all__ = ["unavailable_signal"]

_SEVERAL = "coupler_draft", "coupler_buff"
_AIR_BRAKE = "pipe_pressure", "pipe_pressure_tail", "shoe_force"
_AVAILABLE: dict[str, Callable[[TrainLayout, Line], bool]] = {
    "limit": lambda layout, line: bool(line.speed_limits),
    **dict.fromkeys(("permitted_speed", "emergency_brake_speed"), lambda layout, line: layout.supervised),
    **dict.fromkeys(("command", "effort"), lambda layout, line: layout.n_units > 0),
    **dict.fromkeys(_SEVERAL, lambda layout, line: layout.n_vehicles > 1),
    **dict.fromkeys(_AIR_BRAKE, lambda layout, line: layout.air_brake),
}
"""Condition of the signals that have one."""


def unavailable_signal(names: Iterable[str], layout: TrainLayout, line: Line) -> str:
    """Return the reason and remedy for the first signal that a run does not have, "" if it has all."""
    for name in names:
        found = find_signal(name)
        assert found is not None, name
        signal, unit = found
        if signal.name in _AVAILABLE and not _AVAILABLE[signal.name](layout, line):
            return f"signal '{name}': the run needs {signal.needs}; use another signal"
        if unit is not None and unit >= layout.n_units:
            last = layout.n_units - 1
            units = f"{signal.name}_0 to {signal.name}_{last}" if last else f"{signal.name}_0"
            return f"signal '{name}': the train has {layout.n_units} power units; use {units}"
    return ""
