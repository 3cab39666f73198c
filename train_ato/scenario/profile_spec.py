"""The ``profile:`` block of a scenario: a file, phases, points, steps, a plan, or a driver's run."""

from pathlib import Path
from typing import Any

from pydantic import Field, model_validator

from plant_sim.consist import Consist
from plant_sim.line import Line
from plant_sim.si_model import SiModel, option
from plant_sim.units import Place, Time
from train_ato.control.open_loop import DriverAction
from train_ato.messages.types import Array
from train_ato.profile.driver import simulate_actions
from train_ato.profile.file import Point, Step, csv_text, from_points, from_steps, parse_csv, read_profile
from train_ato.profile.motion import Motion, MotionLimits, Phase, PhaseBuilder
from train_ato.profile.planner.settings import OF_TRAIN, PlanSettings
from train_ato.profile.profile import Profile

SOURCES = ("file", "knots", "phases", "points", "steps", "plan", "driver")


class ProfileSpec(SiModel):
    """Speed profile of a run, from exactly one of file, knots, phases, points, steps, plan, driver."""

    file: str | None = option(
        None, "CSV or YAML file of the profile, in the folder of the scenario or the current one", example="profile.csv"
    )
    knots: str | None = option(
        None,
        "text of a CSV profile, in place of its file",
        example="time,position,speed,acceleration\n0,150,0,0\n60,150,0,0\n",
    )
    phases: tuple[Phase, ...] | None = option(
        None,
        "phases of the motion in their order",
        example=[{"accelerate_to": 20.0}, {"cruise_for": 60.0}, {"brake_to": 0.0}],
        min_length=1,
    )
    points: tuple[Point, ...] | None = option(
        None,
        "corners of the speed curve",
        example=[{"place": 0.0, "speed": 0.0}, {"place": 600.0, "speed": 20.0}, {"place": 1200.0, "speed": 0.0}],
        min_length=2,
    )
    steps: tuple[Step, ...] | None = Field(None, min_length=1)
    plan: PlanSettings | None = option(
        None, "profile of the planner, of minimum time or for a timetable", example={"time": 900.0}
    )
    driver: tuple[DriverAction, ...] | None = option(
        None,
        "notches and brake-pipe reductions of a driver: a run without a law, whose profile is the mean "
        "speed of the nominal train on them",
        example=[{"time": 0.0, "notch": 2}, {"place": 1200.0, "notch": 0, "reduction": 50e3}],
        min_length=1,
    )
    limits: MotionLimits = option(MotionLimits(), "limits of phases, points and append")
    start: Place | None = option(
        None, "position of vehicle 0's centre at the begin; default: begin of the line", example=150.0
    )
    until: Time | None = option(
        None, "end of the last step; for the other sources the time at which the profile is cut", example=600.0, gt=0
    )
    since: Time | None = option(
        None,
        "time of the profile at which the run begins, with the train in motion; default: its begin",
        example=450.0,
        gt=0,
    )
    append: tuple[Phase, ...] = option((), "phases after the end of the profile", example=[{"brake_to": 0.0}])
    allow_rolling_end: bool = option(False, "a profile that does not end at rest is accepted")

    @model_validator(mode="after")
    def _one_source(self) -> "ProfileSpec":
        given = [source for source in SOURCES if getattr(self, source) is not None]
        if len(given) != 1:
            raise ValueError(
                f"a profile has {', '.join(given) or 'no source'}; give exactly one of {', '.join(SOURCES)}"
            )
        for key in ("until", "since", "append"):
            if self.driver is not None and getattr(self, key):
                raise ValueError(f"{key} with driver: the actions of the driver are the run; remove {key}")
        if self.steps is not None and self.until is None:
            raise ValueError("steps need an end; add until")
        return self

    def build(
        self,
        consist: Consist,
        line: Line,
        period: float,
        *,
        folder: Path | None = None,
        reduction: float | None = None,
        ceiling: tuple[Array, Array] | None = None,
        begun: tuple[float, float] = (0.0, 0.0),
    ) -> Profile:
        """Return the profile.

        Parameters
        ----------
        consist, line
            Train and line of the run.
        period
            Time between the knots [s]: the tick of the run.
        folder
            Folder of relative file names.
        reduction
            Deepest brake-pipe reduction that a plan may use [Pa]; None: that of the largest braking factor.
        ceiling : pair of arrays, optional
            Places of the front [m], increasing, and speeds [m/s] of an additional speed limit of a plan.
        begun
            Duration of a driver's run [s] and speed at its begin [m/s].
        """
        if self.plan is None:
            profile = self._unplanned(consist, line, period, folder or Path(), begun)
        else:
            from train_ato.profile.planner.planner import plan_profile  # a late import: it compiles kernels

            found = plan_profile(line, consist, self.plan, period=period, reduction=reduction, ceiling=ceiling)
            profile = found.profile
        if self.until is not None and self.steps is None:
            profile = profile.until(self.until)
        if self.append:
            profile = _append(profile, self.append, self.limits, consist, period)
        if self.since is not None:
            profile = profile.since(self.since)
        if profile.ends_rolling and not self.allow_rolling_end and self.driver is None:
            speed = 3.6 * float(profile.velocity[-1])
            raise ValueError(
                f"the profile ends rolling at {speed:.1f} km/h after {profile.end:.1f} s; let it end at rest "
                "(profile.append: [{brake_to: 0}]) or set profile.allow_rolling_end: true"
            )
        check_on_line(profile, consist, line)
        return profile

    def file_in(self, folder: Path) -> Path:
        """Return the path of the file: in the folder of the scenario, else as given."""
        assert self.file is not None
        return folder / self.file if (folder / self.file).is_file() else Path(self.file)

    def _unplanned(
        self, consist: Consist, line: Line, period: float, folder: Path, begun: tuple[float, float]
    ) -> Profile:
        """Return the profile of a source that is not a plan."""
        start = line.begin if self.start is None else self.start
        half = consist.vehicles[0].length / 2
        if self.file is not None:
            return self._move_to_start(read_profile(self.file_in(folder), period))
        if self.knots is not None:
            return self._move_to_start(parse_csv(self.knots, period))
        if self.phases is not None:
            motion = Motion(0.0, start)
            PhaseBuilder(self.limits, consist).append_phases(motion, self.phases)
            return motion.sampled(period)
        if self.points is not None:
            return from_points(self.points, self.limits.jerk, start, half, period)
        if self.steps is not None:
            assert self.until is not None
            return from_steps(self.steps, self.until, start, period)
        assert self.driver is not None
        return simulate_actions(self.driver, consist, line, period, start, *begun)

    def _move_to_start(self, profile: Profile) -> Profile:
        """Return a profile from a file, moved to ``start``."""
        return profile if self.start is None else profile.shifted(self.start - float(profile.position[0]))

    def inlined(self, folder: Path | None = None) -> dict[str, Any]:
        """Return the block as plain data without references: a file is replaced by its ``knots``."""
        data = self.model_dump(mode="json", by_alias=True, exclude_defaults=True)  # null switches a limit off
        if self.plan is not None:  # a train can have another default
            data["plan"] |= {key: getattr(self.plan, key) for key in OF_TRAIN if key in self.plan.model_fields_set}
        if self.file is not None:
            del data["file"]
            data["knots"] = csv_text(read_profile(self.file_in(folder or Path())), f"from {Path(self.file).name}")
        return data


def _append(
    profile: Profile, phases: tuple[Phase, ...], limits: MotionLimits, consist: Consist, period: float
) -> Profile:
    motion = Motion(
        profile.end, float(profile.position[-1]), float(profile.velocity[-1]), float(profile.acceleration[-1])
    )
    PhaseBuilder(limits, consist).append_phases(motion, phases)
    return profile.followed_by(motion.sampled(period))


def check_on_line(profile: Profile, consist: Consist, line: Line, remedy: str = "") -> None:
    """Check that the front of the train stays on the line; ``remedy`` is that of a profile from elsewhere."""
    front = profile.position + consist.vehicles[0].length / 2
    far, near = int(front.argmax()), int(front.argmin())
    if front[far] > line.end + 1e-3:
        raise ValueError(
            f"the profile moves the front to km {front[far] / 1000:.3f} after {profile.time[far]:.1f} s, beyond the "
            f"end of line '{line.name}' at km {line.end / 1000:.3f}; "
            f"{remedy or 'shorten the profile or lengthen the line'}"
        )
    if front[near] < line.begin - 1e-3:
        raise ValueError(
            f"the profile moves the front to km {front[near] / 1000:.3f} after {profile.time[near]:.1f} s, before the "
            f"begin of line '{line.name}' at km {line.begin / 1000:.3f}; "
            f"{remedy or 'start further on or lengthen the line'}"
        )
