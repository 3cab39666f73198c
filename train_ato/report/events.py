"""What can happen during a run: the kinds of event, their words and colours."""

from __future__ import annotations

from dataclasses import dataclass

from train_ato.report.quantities import BLACK, BLUE, BROWN, GREEN, GREY, ORANGE, PURPLE, SKY, VERMILLION


@dataclass(frozen=True)
class Kind:
    """A kind of event: what the legend says, and its colour."""

    words: str
    colour: str


KINDS: dict[str, Kind] = {
    "law": Kind("law or its parameters changed", PURPLE),
    "air_brake": Kind("air brake applied, released", BROWN),
    "limit": Kind("force cut at its limit", ORANGE),
    "disturbance": Kind("disturbance", SKY),
    "outside": Kind("gust, delay or emergency brake given", BLUE),
    "plan": Kind("profile planned anew", GREEN),
    "fault": Kind("fault", VERMILLION),
    "scored": Kind("end of the scored part", GREY),
    "end": Kind("end of an unfinished run", BLACK),
}


@dataclass(frozen=True)
class Event:
    """Something that happened.

    Attributes
    ----------
    kind
        Key of :data:`KINDS`.
    begin, end
        Times [s]; ``end`` is None for a moment.
    text
        What it was.
    """

    kind: str
    begin: float
    text: str
    end: float | None = None
