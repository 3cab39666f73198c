"""The ``profile:`` block of a scenario: a file, phases, points, steps or a plan."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pydantic import Field, model_validator

from plant_sim.consist import Consist
from plant_sim.line import Line
from plant_sim.units import Length, SiModel, Time
from train_ato.plan.settings import PlanSettings
from train_ato.profile.file import csv_text, parse_csv, read_profile
from train_ato.profile.motion import Motion
from train_ato.profile.phases import MotionLimits, Phase, drive
from train_ato.profile.points import Point, Step, from_points, from_steps
from train_ato.profile.profile import Profile

__all__ = ["ProfileSpec"]

WAYS = ("file", "knots", "phases", "points", "steps", "plan")


class ProfileSpec(SiModel):
    """How the speed profile of a run comes about; exactly one of file, knots, phases, points, steps, plan is given."""

    file: str | None = Field(None, description="CSV or YAML file, relative to the scenario's folder")
    knots: str | None = Field(None, description="the text of a CSV profile itself")
    phases: tuple[Phase, ...] | None = Field(None, min_length=1)
    points: tuple[Point, ...] | None = Field(None, min_length=2)
    steps: tuple[Step, ...] | None = Field(None, min_length=1)
    plan: PlanSettings | None = Field(None, description="minimum-time or timetable run of the planner")
    limits: MotionLimits = Field(MotionLimits(), description="of phases, points and then")
    start: Length | None = Field(
        None, description="position of vehicle 0's centre at the begin; default: the line's begin"
    )
    until: Time | None = Field(None, gt=0, description="of steps: their end; otherwise the profile is cut there")
    then: tuple[Phase, ...] = Field((), description="phases put at the end, for example a brake to standstill")
    allow_rolling_end: bool = Field(False, description="accept a profile that does not end at rest")

    @model_validator(mode="after")
    def _one_way(self) -> ProfileSpec:
        given = [way for way in WAYS if getattr(self, way) is not None]
        if len(given) != 1:
            raise ValueError(
                f"a profile is exactly one of {', '.join(WAYS)}; this one has {', '.join(given) or 'none'}"
            )
        if self.steps is not None and self.until is None:
            raise ValueError("steps need until, the time of their end")
        return self

    def build(
        self, consist: Consist, line: Line, period: float, folder: Path | None = None, reduction: float | None = None
    ) -> Profile:
        """Make the profile.

        Parameters
        ----------
        consist, line
            Of the train that will follow it.
        period
            Of the knots [s]: the tick of the run.
        folder
            Where the name of a file starts.
        reduction
            Deepest reduction of the brake pipe in the run [Pa], which a plan may count on; None: what the train knows.

        Raises
        ------
        ValueError
            One line: what does not fit, where, and what to do.
        """
        profile = self._made(consist, line, period, folder or Path(), reduction)
        if self.until is not None and self.steps is None:
            profile = profile.until(self.until)
        if self.then:
            profile = _continued(profile, self.then, self.limits, consist, period)
        if profile.ends_rolling and not self.allow_rolling_end:
            speed = 3.6 * float(profile.velocity[-1])
            raise ValueError(
                f"the profile ends rolling at {speed:.1f} km/h after {profile.end:.1f} s; let it end at rest "
                "(then: [{brake_to: 0}]) or set allow_rolling_end: true"
            )
        check_on_line(profile, consist, line)
        return profile

    def _made(self, consist: Consist, line: Line, period: float, folder: Path, reduction: float | None) -> Profile:
        start = line.begin if self.start is None else self.start
        half = consist.vehicles[0].length / 2
        if self.file is not None:
            return self._placed(read_profile(folder / self.file, period))
        if self.knots is not None:
            return self._placed(parse_csv(self.knots, period))
        if self.phases is not None:
            motion = Motion(0.0, start)
            drive(motion, self.phases, self.limits, consist)
            return motion.sampled(period)
        if self.points is not None:
            return from_points(self.points, self.limits.jerk, start, half, period)
        if self.steps is not None:
            assert self.until is not None
            return from_steps(self.steps, self.until, start, period)
        from train_ato.plan.planner import plan  # the planner compiles kernels: only those who plan pay for them

        assert self.plan is not None
        return plan(line, consist, self.plan, period=period, reduction=reduction).profile

    def _placed(self, profile: Profile) -> Profile:
        """Move a profile from a file so that it starts where ``start`` says."""
        return profile if self.start is None else profile.shifted(self.start - float(profile.position[0]))

    def inlined(self, folder: Path | None = None) -> dict[str, Any]:
        """Return the block as plain data that needs no other file: a named file is written out as ``knots``."""
        data = self.model_dump(mode="json", by_alias=True, exclude_defaults=True)  # a null is a limit taken away
        if self.file is not None:
            del data["file"]
            data["knots"] = csv_text(read_profile((folder or Path()) / self.file), f"from {Path(self.file).name}")
        return data


def _continued(
    profile: Profile, phases: tuple[Phase, ...], limits: MotionLimits, consist: Consist, period: float
) -> Profile:
    motion = Motion(
        profile.end, float(profile.position[-1]), float(profile.velocity[-1]), float(profile.acceleration[-1])
    )
    drive(motion, phases, limits, consist)
    return profile.followed_by(motion.sampled(period))


def check_on_line(profile: Profile, consist: Consist, line: Line) -> None:
    """Refuse a profile that leads the train's front off the line.

    Raises
    ------
    ValueError
        With the place and the time.
    """
    front = profile.position + consist.vehicles[0].length / 2
    far, near = int(front.argmax()), int(front.argmin())
    if front[far] > line.end + 1e-3:
        raise ValueError(
            f"the profile leads the front to km {front[far] / 1000:.3f} after {profile.time[far]:.1f} s, beyond the "
            f"end of line '{line.name}' at km {line.end / 1000:.3f}; shorten the profile or lengthen the line"
        )
    if front[near] < line.begin - 1e-3:
        raise ValueError(
            f"the profile leads the front to km {front[near] / 1000:.3f} after {profile.time[near]:.1f} s, before the "
            f"begin of line '{line.name}' at km {line.begin / 1000:.3f}; start further on or lengthen the line"
        )
