"""A new topic is one entry of the topic table and one dataclass, without other changes."""

from dataclasses import dataclass, field, fields
from pathlib import Path

import numpy as np
import pytest
from engine_runs import setup_of

import train_ato
from msgs_docs.generate.topic_page import examples, page
from plant_sim.states import described
from train_ato.log.run_folder import RunFolder
from train_ato.loop import engine, stages
from train_ato.loop.plant import PlantStage
from train_ato.loop.stage_messages import PlantMessages, on
from train_ato.messages.codec import Wire
from train_ato.messages.topic import AIR_BRAKE, Condition, Owner, Place, Role, Topic, TrainLayout, joint_states
from train_ato.messages.topics import BY_NAME, TOPICS, topics_of
from train_ato.messages.types import Array, Diagnostic


@dataclass(frozen=True, slots=True)
class Motors:
    """Temperature of every motor and slip of every axle."""

    stamp: int
    temperature: Array = field(metadata=described("temperature", "K", "of the winding"))
    slip: Array = field(metadata=described("slip", "m/s", "rim less train speed"))


@dataclass(frozen=True, slots=True)
class Cabin:
    """Temperature of the cabin: a type of ROS message of no other topic."""

    stamp: int
    temperature: float = field(metadata=described("temperature", "K", "of the air"))


MOTORS = Topic(
    "train/motors", "sensor_msgs/msg/JointState", Motors,
    joint_states(Owner.UNIT, position="temperature", velocity="slip"), publishers=(Role.PLANT,),
    meaning="motors of every power unit",
)  # fmt: skip
CABIN = Topic(
    "train/cabin", "sensor_msgs/msg/Temperature", Cabin, (Place("temperature", "temperature"),),
    publishers=(Role.PLANT,), meaning="air of the driver's cabin",
    condition=Condition(lambda layout: layout.n_units > 0, "only with a power unit"),
)  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class WarmMessages(PlantMessages):
    """Messages of a plant with motors and a cabin."""

    motors: Motors = field(metadata=on(MOTORS.name))
    cabin: Cabin = field(metadata=on(CABIN.name))


class WarmPlant(PlantStage):
    """Plant with motors whose temperature rises by 1 K in each tick."""

    def observe(self) -> PlantMessages:
        """Measure at t_k."""
        found = super().observe()
        units = np.arange(float(self.setup.layout.n_units))
        motors = Motors(self.stamp, 300.0 + self.tick + units, 0.01 * units)
        cabin = Cabin(self.stamp, 293.0 + 0.5 * self.tick)
        return WarmMessages(*(getattr(found, entry.name) for entry in fields(found)), motors=motors, cabin=cabin)


@pytest.fixture
def table(monkeypatch: pytest.MonkeyPatch) -> None:
    """Add the two topics to the table for one test."""
    monkeypatch.setitem(BY_NAME, MOTORS.name, MOTORS)
    monkeypatch.setitem(BY_NAME, CABIN.name, CABIN)


@pytest.mark.usefixtures("table")
def test_a_new_topic_is_recorded_and_opens_as_a_table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Breaks if codec, engine, log or tables have a list of topics of their own."""
    monkeypatch.setattr(stages, "PlantStage", WarmPlant)
    setup = setup_of("demo", "duration=5")
    folder = RunFolder.make(tmp_path / "run", "warm")
    with folder.sink(setup) as sink:
        outcome = engine.run_engine(setup, sink=sink)
    assert outcome.failure is None
    assert outcome.published[MOTORS.name] == outcome.published[CABIN.name] == setup.ticks
    frames = train_ato.load(folder.path)
    motors, cabin = frames[MOTORS.name], frames[CABIN.name]
    names = [f"unit_{i}" for i in range(setup.layout.n_units)]
    assert list(motors) == [*(f"{name}_temperature_k" for name in names), *(f"{name}_slip_m_s" for name in names)]
    assert list(cabin) == ["temperature_k"]
    assert motors["unit_0_temperature_k"].tolist() == [300.0 + tick for tick in range(setup.ticks)]
    assert cabin["temperature_k"].tolist() == [293.0 + 0.5 * tick for tick in range(setup.ticks)]
    assert motors.index.tolist() == frames["train/measurement"].index.tolist()


@pytest.mark.usefixtures("table")
def test_a_new_topic_is_on_the_page_and_exists_where_its_condition_holds() -> None:
    """Breaks if the page has a list of its own, omits units, meaning or condition, or that is evaluated elsewhere."""
    text = page()
    assert "| `unit_I_temperature_k` | K | of the winding |" in text
    assert "| `unit_I_slip_m_s` | m/s | rim less train speed |" in text
    assert "Air of the driver's cabin (only with a power unit)." in text
    assert MOTORS in topics_of(TrainLayout(3, 0)) and CABIN not in topics_of(TrainLayout(3, 0))
    with pytest.raises(KeyError):
        Wire(TrainLayout(3, 0)).encode(CABIN.name, Cabin(0, 293.0))


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({"places": joint_states(Owner.UNIT, position="temperature")}, "every field of Motors needs one place"),
        ({"places": joint_states(Owner.UNIT, position="heat")}, "Motors has no field 'heat'"),
        ({"places": joint_states(Owner.UNIT, torque="temperature", velocity="slip")}, "has no field 'torque'"),
        ({"type": "std_msgs/msg/Float64MultiArray"}, "has no field"),
        ({"message": Cabin, "places": (Place("name", "temperature"),)}, "not float64"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_an_entry_that_does_not_fit_is_refused(changes: dict[str, object], problem: str) -> None:
    """Breaks if a wrong entry is detected only by a run, or not at all."""
    entry = {name: getattr(MOTORS, name) for name in Topic.__dataclass_fields__} | changes
    with pytest.MonkeyPatch.context() as patch, pytest.raises(ValueError, match=problem):
        patch.setitem(BY_NAME, MOTORS.name, Topic(**entry))
        Wire(TrainLayout(3, 2))


def test_every_entry_describes_its_numbers() -> None:
    """Breaks if a number of the table has no unit, or a text, a state or a counter has one."""
    without = {"train/protection.active", "atp/brake_release.released", "atp/brake_release.alive", "ato/state.state"}
    for topic in BY_NAME.values():
        for place in topic.places:
            texts = f"{topic.name}.{place.field}" in without or topic.message is Diagnostic
            assert bool(topic.description(place).unit) != texts, (topic.name, place.path)
    assert BY_NAME["train/brake_shoes"].condition is AIR_BRAKE


def test_every_topic_has_an_example() -> None:
    """Breaks if a run of the examples misses a topic, or a program must publish a topic that no node reads."""
    assert examples().keys() >= {topic.name for topic in TOPICS}
    assert [topic.name for topic in TOPICS if not (topic.readers or topic.optional)] == ["/diagnostics"]
