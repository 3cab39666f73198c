"""Interventions on the train during a run: gust, delay jump, emergency brake, and faults of messages and of the train.

A scenario plans them, or a service call of the node ``plant`` requests them during the run.  Each takes effect at a
tick; the plant's diagnostics of that tick contain it as JSON under the key ``interventions``.  The run can therefore be
repeated from its log.

Requests to the ATO (engage, disengage, reset) are planned, or made by a service of the node ``controller``, in the same
way. The diagnostics of the controller contain each accepted request.
"""

import json
from collections.abc import Iterable
from typing import Annotated, Any, Literal, get_args

from pydantic import Field, TypeAdapter, ValidationError

from plant_sim.si_model import SiModel, option
from plant_sim.units import Acceleration, Number, Time, number_text
from train_ato.messages.delay_lines import MAX_DELAY
from train_ato.messages.faults import MAX_FAULT_TIME

KEY = "interventions"
"""Key of the plant's diagnostics that contains the interventions of one tick."""
MAX_GUST = 1.0
MAX_GUST_DURATION = 3600.0
SECOND = 1_000_000_000
PlantTopic = Literal["ato/command", "ato/brake_pipe_command", "atp/brake_release"]
"""Topics that the plant reads."""


class _TimedIntervention(SiModel):
    """Base of every intervention: its planned time."""

    at: Time | None = option(
        None, "time of the intervention; null: the next tick after the request", example=60.0, ge=0
    )

    def described(self) -> str:
        """Return a readable description with its values."""
        values = self.model_dump(exclude={"do", "at"})
        texts = [f"{name} {value if isinstance(value, str) else number_text(value)}" for name, value in values.items()]
        return f"{self.model_dump()['do']}: " + ", ".join(texts)


class GustNow(_TimedIntervention):
    """A gust on every vehicle: an acceleration with a rising ramp, a constant part and a falling ramp."""

    do: Literal["gust"] = "gust"
    acceleration: Acceleration = Field(
        ge=-MAX_GUST, le=MAX_GUST, description="acceleration of every vehicle; < 0: headwind", examples=[-0.05]
    )
    duration: Time = Field(ge=1e-6, le=MAX_GUST_DURATION, description="duration with both ramps", examples=[20.0])
    ramp: Time = option(1.0, "duration of each ramp, at most half of the duration", ge=0, le=MAX_GUST_DURATION)


class DelayJumpNow(_TimedIntervention):
    """Change of the command delays: delay x product of all factors + sum of all ``add`` of the changes so far."""

    do: Literal["delay_jump"] = "delay_jump"
    factor: Number = option(1.0, "factor on the command delays", example=2.0, ge=0, le=1000)
    add: Time = option(0.0, "time that is added to the command delays", example=0.2, ge=-MAX_DELAY, le=MAX_DELAY)


class EmergencyBrakeNow(_TimedIntervention):
    """The emergency brake: applied, or released (at standstill only)."""

    do: Literal["emergency_brake"] = "emergency_brake"
    applied: bool = option(True, "true applies the emergency brake, false releases it")

    def described(self) -> str:
        """Return a readable description with its values."""
        return "emergency brake applied" if self.applied else "emergency brake released"


class MessageLossNow(_TimedIntervention):
    """Messages of a topic do not arrive at the plant for a time."""

    do: Literal["message_loss"] = "message_loss"
    topic: PlantTopic = option("ato/command", "topic whose messages do not arrive")
    duration: Time = Field(gt=0, le=MAX_FAULT_TIME, description="duration of the loss", examples=[2.0])


class MessageFreezeNow(_TimedIntervention):
    """Content of a topic that does not change for a time, with new stamps; of the measurement: its sensors."""

    do: Literal["message_freeze"] = "message_freeze"
    topic: PlantTopic | Literal["train/measurement"] = option("ato/command", "topic whose content does not change")
    duration: Time = Field(gt=0, le=MAX_FAULT_TIME, description="duration of the constant content", examples=[2.0])


class TrainJumpNow(_TimedIntervention):
    """Factor on the forces of all drives or shoes, or on the adhesion, for the rest of the run."""

    do: Literal["train_jump"] = "train_jump"
    what: Literal["gain", "brake", "adhesion"] = Field(
        description="forces of the drives (gain), of the shoes (brake), or adhesion"
    )
    factor: Number = Field(ge=0, le=10, description="factor on the forces or on the adhesion", examples=[0.8])


Intervention = Annotated[
    GustNow | DelayJumpNow | EmergencyBrakeNow | MessageLossNow | MessageFreezeNow | TrainJumpNow,
    Field(discriminator="do"),
]
_LIST: TypeAdapter[list[Intervention]] = TypeAdapter(list[Intervention])


def interventions_to_json(interventions: Iterable[Intervention]) -> str:
    """Return the interventions of one tick as JSON text for the diagnostics."""
    return json.dumps([entry.model_dump(exclude={"at"}) for entry in interventions])


def interventions_from_json(text: str) -> list[Intervention]:
    """Return the interventions of one tick from the JSON text of the diagnostics.

    Raises
    ------
    ValueError
        If the text was not written by :func:`interventions_to_json`.
    """
    try:
        return _LIST.validate_json(text)
    except ValidationError:
        problem = "not written by this version; open the run with its own version"
        raise ValueError(f"{KEY} '{text[:60]}': {problem}") from None


def make_intervention(kind: type[Any], **values: Any) -> Any:
    """Return an intervention of a kind with checked values.

    Raises
    ------
    ValueError
        If a value is out of range; one line with its name.
    """
    try:
        return kind(**values)
    except ValidationError as error:
        first = error.errors()[0]
        name = ".".join(map(str, first["loc"]))
        raise ValueError(f"{name} {first['input']!r}: {first['msg'][:1].lower()}{first['msg'][1:]}") from None


def due_stamp(intervention: Intervention, tick_ns: int) -> int:
    """Return the stamp of the tick at which a planned intervention takes effect [ns]."""
    at = round((intervention.at or 0.0) * SECOND)
    return -(-at // tick_ns) * tick_ns


def planned_for(stamp: int, intervention: Intervention) -> Intervention:
    """Return an intervention with a stamp [ns] as its planned time."""
    return intervention.model_copy(update={"at": stamp / SECOND})


REQUEST_KEY = "ato_request"
"""Key of the controller's diagnostics that contains an accepted request."""
Request = Literal["engage", "disengage", "reset"]
REQUESTS: tuple[Request, ...] = get_args(Request)


class AtoRequest(SiModel):
    """One request; an engagement waits until the ATO is ready."""

    at: Time = Field(ge=0, description="time of the request", examples=[60.0])
    do: Request = Field(description="requested action")


def request_from_text(text: str) -> Request:
    """Return the accepted request in the diagnostics of the controller.

    Raises
    ------
    ValueError
        If the text is not a request of this version.
    """
    if text in REQUESTS:
        return text
    raise ValueError(f"{REQUEST_KEY} '{text[:60]}': not written by this version; open the run with its own version")
