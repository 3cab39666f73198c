"""Sizes of a train that fix which topics a run has and how long their messages are."""

from __future__ import annotations

from dataclasses import dataclass

from train_ato.topics import TOPICS, Rate, Topic


@dataclass(frozen=True)
class Shape:
    """Sizes that fix the layout of a run's messages.

    Parameters
    ----------
    n_vehicles, n_units
        Vehicles and power units of the train.
    sensors
        Numbers of the vehicles behind which a coupler sensor is fitted.
    air_brake, disturbed
        Whether the train has an air brake, and the run disturbances; without them their topics do not exist.
    """

    n_vehicles: int
    n_units: int
    sensors: tuple[int, ...] = ()
    air_brake: bool = False
    disturbed: bool = False

    @property
    def cars(self) -> tuple[str, ...]:
        """Names of the vehicles."""
        return tuple(f"car_{i}" for i in range(self.n_vehicles))

    @property
    def units(self) -> tuple[str, ...]:
        """Names of the power units."""
        return tuple(f"unit_{i}" for i in range(self.n_units))

    @property
    def couplers(self) -> tuple[str, ...]:
        """Names of the coupler sensors."""
        return tuple(f"coupler_{i}" for i in self.sensors)

    def has(self, topic: Topic) -> bool:
        """Tell whether a run of this train has the topic."""
        if topic.name in ("train/brake_pipe", "train/brake_cylinders", "ato/brake_pipe"):
            return self.air_brake
        return self.disturbed or topic.name != "train/disturbance"

    @property
    def topics(self) -> tuple[Topic, ...]:
        """Topics of the table that a run of this train has."""
        return tuple(topic for topic in TOPICS if self.has(topic))

    @property
    def tick_topics(self) -> tuple[str, ...]:
        """Names of the recorded topics that carry one message per tick."""
        return tuple(topic.name for topic in self.topics if topic.recorded and topic.rate is Rate.TICK)
