"""Signals of requirements: name, unit, meaning and condition; their series: :mod:`train_ato.judge.requirements`."""

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from plant_sim.line import Line
from train_ato.messages.topic import TrainLayout


@dataclass(frozen=True)
class Need:
    """Condition of a signal, as text and as a predicate."""

    text: str = ""
    holds: Callable[[TrainLayout, Line], bool] = lambda layout, line: True


@dataclass(frozen=True)
class RequirementSignal:
    """Signal of a run, one sample per tick.

    Attributes
    ----------
    name
        Name in a formula.
    unit
        SI unit of the samples.
    meaning
        Definition.
    needs
        Condition under which a run has the signal.
    by_unit
        True: ``NAME_I`` is the signal of power unit I.
    """

    name: str
    unit: str
    meaning: str
    needs: Need = Need()
    by_unit: bool = False


_BRAKE = Need("an air brake", lambda layout, line: layout.air_brake)
_LIMITS = Need("a line with speed limits", lambda layout, line: bool(line.speed_limits))
_SUPERVISOR = Need("a supervisor", lambda layout, line: layout.supervised)
_UNIT = Need("a power unit", lambda layout, line: layout.n_units > 0)
_COUPLER = Need("more than one vehicle", lambda layout, line: layout.n_vehicles > 1)
SIGNALS: dict[str, RequirementSignal] = {
    signal.name: signal
    for signal in (
        RequirementSignal("time", "s", "time since the start of the run"),
        RequirementSignal("speed", "m/s", "speed of vehicle 0, the truth"),
        RequirementSignal("reference_speed", "m/s", "speed of the profile"),
        RequirementSignal("speed_error", "m/s", "speed minus reference speed, of vehicle 0"),
        RequirementSignal("limit", "m/s", "lowest speed limit under the train", _LIMITS),
        RequirementSignal("permitted_speed", "m/s", "permitted speed of the supervisor", _SUPERVISOR),
        RequirementSignal("emergency_brake_speed", "m/s", "speed of the emergency brake intervention", _SUPERVISOR),
        RequirementSignal("acceleration", "m/s²", "mean acceleration of vehicle 0 over the last 0.1 s or tick"),
        RequirementSignal("jerk", "m/s³", "change of the mean acceleration from one second to the next"),
        RequirementSignal("position", "m", "chainage of the centre of vehicle 0, the truth"),
        RequirementSignal("front", "m", "chainage of the front of the train"),
        RequirementSignal("reference_position", "m", "position of the profile"),
        RequirementSignal("position_error", "m", "position minus reference position, of vehicle 0"),
        RequirementSignal("distance_to_stop", "m", "distance to the next stop or the end of the profile, < 0 beyond"),
        RequirementSignal("command", "N", "command of all power units; `command_I`: of unit I", _UNIT, True),
        RequirementSignal(
            "effort", "N", "applied force of all power units, measured; `effort_I`: of unit I", _UNIT, True
        ),
        RequirementSignal("coupler_draft", "N", "largest draft along the train at the tick", _COUPLER),
        RequirementSignal("coupler_buff", "N", "largest buff along the train, < 0", _COUPLER),
        RequirementSignal("pipe_pressure", "Pa", "brake-pipe pressure at the head", _BRAKE),
        RequirementSignal("pipe_pressure_tail", "Pa", "brake-pipe pressure at the tail", _BRAKE),
        RequirementSignal("shoe_force", "N", "force of all brake shoes", _BRAKE),
    )
}
"""All signals by name."""
_OF_UNIT = re.compile(r"(.+)_(\d{1,3})")


def find_signal(name: str) -> tuple[RequirementSignal, int | None] | None:
    """Return a signal and the number of its power unit by its name in a formula; None for an unknown name."""
    if name in SIGNALS:
        return SIGNALS[name], None
    parts = _OF_UNIT.fullmatch(name)
    signal = SIGNALS.get(parts[1]) if parts else None
    return (signal, int(parts[2])) if parts and signal is not None and signal.by_unit else None


def unavailable_signal(names: Iterable[str], layout: TrainLayout, line: Line) -> str:
    """Return the reason and remedy for the first signal that a run does not have, "" if it has all."""
    for name in names:
        found = find_signal(name)
        assert found is not None, name
        signal, unit = found
        if not signal.needs.holds(layout, line):
            return f"signal '{name}': the run needs {signal.needs.text}; use another signal"
        if unit is not None and unit >= layout.n_units:
            last = layout.n_units - 1
            units = f"{signal.name}_0 to {signal.name}_{last}" if last else f"{signal.name}_0"
            return f"signal '{name}': the train has {layout.n_units} power units; use {units}"
    return ""
