"""Block ``leader:`` of a scenario: the train ahead, which the train follows and which its supervisor keeps free."""

import re
from typing import Literal

from pydantic import field_validator, model_validator

from plant_sim.si_model import SiModel, option
from plant_sim.units import Place, Time
from train_ato.messages.delay_lines import LinkSpec

NAMESPACE = r"(/[A-Za-z_][A-Za-z0-9_]*)+"
"""Form of a namespace of ROS 2."""


def check_namespace(text: str) -> str:
    """Return the namespace of a train; ValueError if ROS 2 does not have it."""
    if not re.fullmatch(NAMESPACE, text):
        raise ValueError(f"{text}: give a name such as /t1")
    return text


class LeaderSpec(SiModel):
    """Reports of the train ahead and their use."""

    reports: str = option(
        "",
        "reports of the train ahead as CSV; `train-ato run` of a following file writes them",
        example="number,time,front,rear,speed,stop\n1,0.0,5721.0,4420.0,18.6,410.0\n",
    )
    train: str | None = option(
        None,
        "namespace of the train ahead in the same ROS domain, which reports live in place of `reports`",
        example="/t1",
        json_schema_extra={"pattern": f"^{NAMESPACE}$"},
    )
    link: LinkSpec = option(
        LinkSpec(),
        "delay and loss of the reports; profile, supervisor and controller have a receiver each",
        example={"delay": 0.8, "loss": 0.05},
    )
    headway: Time | None = option(
        None,
        "time after which the train is where the train ahead was; default: the own profile is followed",
        example=150.0,
        gt=0,
    )
    smoothing: Time = option(30.0, "half of the time over which the motion of the train ahead is averaged", gt=0)
    until: Time | None = option(
        None, "time of the run from which the own profile is followed again", example=2000.0, gt=0
    )
    authority: Literal["absolute", "relative"] | None = option(
        "absolute", "moving end of authority. absolute: safe rear of the train ahead; relative: plus its shortest stop"
    )
    timeout: Time = option(
        5.0, "largest age of the newest report; with an older one the shortest stop does not count", gt=0
    )
    rear_margin: Place = option(10.0, "distance from the safe rear to the end of authority", ge=0)

    @field_validator("train")
    @classmethod
    def _namespace(cls, train: str | None) -> str | None:
        return train if train is None else check_namespace(train)

    @model_validator(mode="after")
    def _known_in_time(self) -> "LeaderSpec":
        self.link.per_unit(1, "link")
        if self.headway is not None and self.headway < self.shortest_headway:
            raise ValueError(
                f"headway {self.headway:g} s: shorter than smoothing, longest delay and a reserve, "
                f"{self.shortest_headway:g} s; increase it or lower smoothing"
            )
        if self.headway is not None and self.until is not None and self.until <= self.headway:
            raise ValueError(
                f"until {self.until:g} s: the first place of the train ahead counts after the headway of "
                f"{self.headway:g} s; increase until, or remove headway"
            )
        return self

    @property
    def shortest_headway(self) -> float:
        """Smallest headway with which the averaged motion is known in time [s]."""
        return self.smoothing + self.link.longest + RESERVE


RESERVE = 10.0
"""Time for which the profile behind a train is known in advance, for the preview of the laws [s]."""
