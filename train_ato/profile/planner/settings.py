"""Settings of the planner: the keys of a scenario's blocks ``profile: plan:`` and ``replan:``."""

from dataclasses import dataclass
from typing import Annotated

from pydantic import model_validator

from plant_sim.consist import Consist
from plant_sim.library import load_consist
from plant_sim.line import Line
from plant_sim.si_model import SiModel, option
from plant_sim.units import Acceleration, Jerk, Length, Number, Place, Power, Speed, Time, Usual
from train_ato.profile.planner.allowance import Allowance
from train_ato.profile.planner.timing_points import TimingPoint, check_points

OF_TRAIN = {
    "speed_max": "speed",
    "acceleration": "acceleration",
    "deceleration": "deceleration",
    "efficiency": "traction_efficiency",
    "recovered": "recovery_efficiency",
}
"""Settings that a train can have, with their keys in its ``plan_limits``."""


class PlanSettings(SiModel):
    """Service limits, force margin, stops and timetable of a plan; places are those of the train's front."""

    begin: Place | None = option(
        None, "place of the front at departure; default: first of several stops, or begin of the line", example=100.0
    )
    end: Place | None = option(
        None, "place of the front at arrival; default: the last stop, or the end of the line", example=12e3
    )
    calling: bool = option(True, "stops at the intermediate stops of the line")
    departure: Time | None = option(
        None,
        "time of the first movement; default: 0, in a scenario from rest the delay and lag of the command",
        example=10.0,
        ge=0,
    )
    dwell: Annotated[Time | None, Usual(2, 14400)] = option(
        None, "time at rest at every intermediate stop; default: as in the stop", example=30.0, ge=0
    )
    time: Time | None = option(
        None,
        "running time of the timetable from departure to arrival, with dwell times; default: minimum time",
        example=900.0,
        gt=0,
    )
    allowance: tuple[Allowance, ...] = option(
        (), "supplements on the least running time, in place of time", example=[{"share": 0.05}, {"per_stop": 10.0}]
    )
    points: tuple[TimingPoint, ...] | None = option(
        None,
        "timing points of a journey, in place of begin, end, calling and time",
        example=[{"at": 0.0, "stop": True}, {"at": 12e3, "stop": True}],
    )
    acceleration: Annotated[Acceleration | None, Usual(1e-3, 10)] = option(
        1.0, "largest acceleration in service; null: limited by the train only", gt=0
    )
    deceleration: Annotated[Acceleration | None, Usual(1e-3, 10)] = option(
        0.8, "largest deceleration in service; null: limited by the train only", gt=0
    )
    jerk: Annotated[Jerk | None, Usual(2e-4, 100)] = option(0.5, "largest jerk; null: no limit", gt=0)
    force_margin: Number = option(
        0.1, "part of the traction and brake envelopes that is reserved for the controller", ge=0, lt=1
    )
    speed_max: Annotated[Speed | None, Usual(0.5, 200)] = option(
        None,
        "largest speed; default: as in plan_limits of the train, else the end of the traction envelope, at "
        "most 98 % of that of the brakes",
        example=20.0,
        gt=0,
    )
    efficiency: Annotated[Number, Usual(0.2, 1)] = option(
        1.0, "traction work over the energy taken from the line", example=0.85, gt=0, le=1
    )
    recovered: Number = option(0.0, "part of the electric brake work that returns to the line", example=0.6, ge=0, le=1)
    auxiliary: Annotated[Power, Usual(500, 20e6)] = option(
        0.0, "auxiliary power, which is part of the net energy at all times", example=100e3, ge=0
    )
    begin_speed: Speed = option(0.0, "speed at the begin", example=20.0, ge=0)
    end_speed: Speed = option(0.0, "speed at the end", example=20.0, ge=0)
    air_brake: bool = option(
        True, "use of the air brake of the train; in a scenario up to the reduction of brake.policy"
    )
    point_mass: bool = option(False, "train as a point at its front, where speed limits, grades and curves end")

    grade_over_length: bool = option(
        False, "averages of grades, curves and tunnels over the length of each vehicle, as in the plant"
    )

    @property
    def has_timetable(self) -> bool:
        """True for a plan with scheduled times, False for one of minimum time."""
        return self.time is not None or self.points is not None or bool(self.allowance)

    @property
    def service_rate(self) -> float:
        """Largest service acceleration or deceleration, at most 2 m/s²."""
        return max(min(self.acceleration or 2.0, 2.0), min(self.deceleration or 2.0, 2.0))

    def for_train(self, consist: Consist) -> "PlanSettings":
        """Return the settings with the ``plan_limits`` of a train for the keys that it does not set."""
        free = {key: name for key, name in OF_TRAIN.items() if key not in self.model_fields_set}
        found = {key: getattr(consist.plan_limits, name, None) for key, name in free.items()}
        return self.model_copy(update={key: value for key, value in found.items() if value is not None})

    @model_validator(mode="after")
    def _places(self) -> "PlanSettings":
        if self.begin is not None and self.end is not None and self.end <= self.begin:
            raise ValueError(
                f"end = {self.end:g} m must lie beyond begin = {self.begin:g} m; exchange them or move end on"
            )
        if self.allowance and self.time is not None:
            raise ValueError("allowance with time: both define the running time; remove one of them")
        if self.points is not None:
            check_points(self.points)
            for key in ("begin", "end", "time", "allowance", "dwell"):
                if getattr(self, key) not in (None, ()):
                    raise ValueError(f"{key} with points: the timing points have it; remove {key}")
            if self.begin_speed > 0 or self.end_speed > 0:
                raise ValueError("begin_speed or end_speed with points: a journey begins and ends at rest; remove it")
        if self.point_mass and self.grade_over_length:
            raise ValueError(
                "grade_over_length = true with point_mass = true: a point mass has no length to average over; set one "
                "of them to false"
            )
        return self


class ReplanSpec(SiModel):
    """Re-planning during the run after a lack of force; ``replan: {}`` uses the defaults."""

    speed_error: Annotated[Speed, Usual(0.005, 15)] = option(
        0.2, "mean speed error over the window that starts the detection", gt=0
    )
    position_error: Length = option(1.0, "growing position error that starts the detection", gt=0)
    confirmation_time: Time = option(
        1.0, "duration of constant force with a growing error; at least delay + 3 lag", gt=0, le=60
    )
    lead: Time = option(
        1.0, "time from the decision to the start of the new profile; at least delay + lag", ge=0, le=60
    )
    interval: Time = option(5.0, "least time between two decisions, doubled after each refused one", ge=0)
    both_ways: bool = option(True, "less brake force after a lack of traction, and vice versa")
    retry: Time | None = option(
        None, "time after which the full traction is assumed again; default: never", example=120.0, gt=0
    )
    catch_up: bool = option(
        False, "return to the timetable at the least net energy; false: never faster than the first profile"
    )
    lateness: Time | None = option(
        None,
        "with catch_up: lateness or earliness from which the rest is planned again; default: never",
        example=5.0,
        gt=0,
    )
    plan: PlanSettings | None = option(
        None,
        "service limits and force_margin of the new plan; default: those of the first plan",
        example={"deceleration": 0.6},
    )

    @model_validator(mode="after")
    def _lateness_with_catch_up(self) -> "ReplanSpec":
        if self.lateness is not None and not self.catch_up:
            raise ValueError("lateness without catch_up: the rest would have the same times; add catch_up: true")
        return self

    def settings(self, own: PlanSettings | None) -> PlanSettings:
        """Return the settings of the new plan; ``own`` are those of the scenario's plan, if there is one."""
        return self.plan or own or PlanSettings(force_margin=0.05)


def find_train(name: str, *, point_mass: bool = False) -> tuple[Consist, PlanSettings]:
    """Return a train and its default plan settings.

    A train of a foreign file can have plan_limits, which define the largest speed and accelerations. Jerk limit and
    force margin are then switched off, because these formats have none; a scenario keeps its own. As a point mass
    the train needs no length.

    Raises
    ------
    ValueError
        One line that names the file, the key, the value and the remedy.
    """
    consist = load_consist(name, point_mass=point_mass)
    if consist.plan_limits is None:
        return consist, PlanSettings()
    settings = PlanSettings(jerk=None, force_margin=0.0)
    free = {key: None for key in ("acceleration", "deceleration") if getattr(consist.plan_limits, key) is None}
    return consist, settings.for_train(consist).model_copy(update=free)


@dataclass(frozen=True, slots=True)
class Stops:
    """Places of the front at all stops, first and last included [m]; dwell times at the intermediate ones [s]."""

    places: tuple[float, ...]
    dwells: tuple[float, ...]


def stops_of(line: Line, settings: PlanSettings) -> Stops:
    """Return the stops of a plan on a line.

    The defaults depend on the line. With several stops the plan is from the first to the last stop, with one stop from
    the begin of the line to the stop, and without stops over the whole line.

    Raises
    ------
    ValueError
        If a stop lies outside the line or the section between begin and end has no length.
    """
    listed = line.stops
    for stop in listed:
        where = f"stop '{stop.name}' at km {stop.at / 1000:.3f}"
        line.check_place(stop.at, where, "move the stop or lengthen the line")
    begin = settings.begin if settings.begin is not None else (listed[0].at if len(listed) > 1 else line.begin)
    end = settings.end if settings.end is not None else (listed[-1].at if listed else line.end)
    for name, place in (("begin", begin), ("end", end)):
        line.check_place(place, f"{name} of the plan at km {place / 1000:.3f}", "choose a place on the line")
    if end - begin < 0.1:
        raise ValueError(
            f"the plan from km {line.post_at(begin)} to km {line.post_at(end)} has no length; move its end on"
        )
    between = [stop for stop in listed if settings.calling and begin + 0.1 < stop.at < end - 0.1]
    dwells = tuple(stop.dwell if settings.dwell is None else settings.dwell for stop in between)
    return Stops((begin, *(stop.at for stop in between), end), dwells)
