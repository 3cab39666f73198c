"""What is done to the train from outside while it runs, as data: gusts, jumps of the delay, the emergency brake.

A scenario may plan them; the rest is asked of the node ``plant`` while it runs.  Each takes effect at a tick and
stands under that tick's stamp in the plant's diagnostics, key ``interventions``, as JSON: the log says what was done,
and the same run can be driven again.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from typing import Annotated, Any, Literal

from pydantic import Field, TypeAdapter, ValidationError

from plant_sim.units import Acceleration, SiModel, Time
from train_ato.links import LONGEST_DELAY

KEY = "interventions"
"""Key of the plant's diagnostics under which those of one tick stand."""
STRONGEST_GUST = 1.0
LONGEST_GUST = 3600.0
SECOND = 1_000_000_000


class _Done(SiModel):
    """What all kinds share."""

    at: Time | None = Field(None, ge=0, description="when it is planned; none: as soon as it is asked for")

    def described(self) -> str:
        """Return it as a person reads it."""
        values = self.model_dump(exclude={"do", "at"})
        return f"{self.model_dump()['do']}: " + ", ".join(f"{name} {value:g}" for name, value in values.items())


class GustNow(_Done):
    """A gust on every vehicle: an acceleration that rises, stays and falls."""

    do: Literal["gust"] = "gust"
    acceleration: Acceleration = Field(ge=-STRONGEST_GUST, le=STRONGEST_GUST, description="< 0 against the line")
    duration: Time = Field(gt=0, le=LONGEST_GUST, description="ramps included")
    ramp: Time = Field(1.0, ge=0, le=LONGEST_GUST, description="time of rise and of fall")


class DelayJumpNow(_Done):
    """Other delays of commands from then on, on top of earlier changes: multiplied, then longer by ``add``."""

    do: Literal["delay_jump"] = "delay_jump"
    factor: float = Field(1.0, ge=0, le=1000)
    add: Time = Field(0.0, ge=-LONGEST_DELAY, le=LONGEST_DELAY)


class EmergencyBrakeNow(_Done):
    """The emergency brake from then on: applied, or released (at standstill only)."""

    do: Literal["emergency_brake"] = "emergency_brake"
    applied: bool = True

    def described(self) -> str:
        """Return it as a person reads it."""
        return "emergency brake applied" if self.applied else "emergency brake released"


Intervention = Annotated[GustNow | DelayJumpNow | EmergencyBrakeNow, Field(discriminator="do")]
_MANY: TypeAdapter[list[Intervention]] = TypeAdapter(list[Intervention])


def as_text(interventions: Iterable[Intervention]) -> str:
    """Return interventions of one tick as they stand in the diagnostics."""
    return json.dumps([entry.model_dump(exclude={"at"}) for entry in interventions])


def from_text(text: str) -> list[Intervention]:
    """Return the interventions of one tick that the diagnostics hold.

    Raises
    ------
    ValueError
        If the text is not theirs.
    """
    try:
        return _MANY.validate_json(text)
    except ValidationError:
        raise ValueError(f"{KEY} '{text[:60]}': not written by this version") from None


def made(kind: type[Any], **values: Any) -> Any:
    """Return an intervention of a kind.

    Raises
    ------
    ValueError
        One line that names the first value that is out of range.
    """
    try:
        return kind(**values)
    except ValidationError as error:
        first = error.errors()[0]
        name = ".".join(map(str, first["loc"]))
        raise ValueError(f"{name} {first['input']!r}: {first['msg'][:1].lower()}{first['msg'][1:]}") from None


def due_stamp(intervention: Intervention, tick_ns: int) -> int:
    """Return the stamp of the tick from which a planned intervention acts [ns]."""
    at = round((intervention.at or 0.0) * SECOND)
    return -(-at // tick_ns) * tick_ns


def planned_for(stamp: int, intervention: Intervention) -> Intervention:
    """Return what was done at a stamp [ns] as a scenario plans it."""
    return intervention.model_copy(update={"at": stamp / SECOND})
