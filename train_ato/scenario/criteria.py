"""The ``criteria:`` block of a scenario: requirements on a run, each optional."""

from typing import Annotated, Literal

from pydantic import AfterValidator, Field, model_validator

from plant_sim.si_model import SiModel, option
from plant_sim.units import Acceleration, Force, Jerk, Length, Ratio, Speed, Time, Usual
from train_ato.scenario.formula import parse_formula


def _checked_formula(text: str) -> str:
    """Return the text of a formula after its check."""
    parse_formula(text)
    return text


RequirementName = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_-]{0,59}$")]
RequirementText = Annotated[str, AfterValidator(_checked_formula)]


class TrackingLimits(SiModel):
    """Limits of the outcome of tracking; the evaluation is in :mod:`train_ato.judge.tracking`.

    Every run is evaluated, also without a block ``criteria``.
    """

    departure_time: Time = option(
        20.0,
        "rest after the departure of the reference; default: longest release of a brake in position P, UIC 540",
        gt=0,
    )
    position_time: Time = option(
        10.0,
        "limit of three errors: the position error as running time at the largest speed of the profile, "
        "the duration of a speed error at the end, and the delay of a standstill. The default is several times the "
        "delay and lag of a control loop",
        gt=0,
    )
    oscillation: Ratio = option(
        0.1, "amplitude of a limit cycle of the command, over the largest force of the unit", gt=0, le=1
    )
    oscillation_time: Time = option(10.0, "shortest duration of a limit cycle", gt=0)
    saturation_time: Time = option(10.0, "time at a force limit with a speed error", gt=0)
    saturation_error: Speed = option(
        2 / 3.6,
        "speed error that counts at a force limit. The default is half of dV_warning_min of SUBSET-026, "
        "A.3.1, the smallest distance between permitted speed and warning",
        gt=0,
    )


class Criteria(SiModel):
    """Requirements on a run; the evaluation is in :mod:`train_ato.judge.verdict`.

    A criterion is a largest permitted magnitude. A missing one is not evaluated. A requirement is a formula over the
    signals of the run (:mod:`train_ato.scenario.signals`).
    """

    stop_window: Annotated[Length | None, Usual(0.005, 50)] = option(
        None, "largest distance of the front from the target at every stop of the profile", example=0.3, gt=0
    )
    arrival_delay: Time | None = option(
        None, "largest delay of the arrival at a stop against the profile", example=5.0, ge=0
    )
    overspeed: Speed | None = option(
        None, "largest speed above the lowest speed limit under the train", example=0.5, ge=0
    )
    speed_error_rms: Speed | None = option(
        None, "root mean square of the speed error over the evaluation", example=0.2, gt=0
    )
    speed_error: Speed | None = option(
        None, "largest speed error of the whole run, the braking to the stop included", example=1.0, gt=0
    )
    position_error: Annotated[Length | None, Usual(0.005, 1e3)] = option(
        None, "largest position error over the evaluation", example=2.0, gt=0
    )
    coupler_draft: Annotated[Force | None, Usual(2e3, 20e6)] = option(
        None, "largest draft of all couplers", example=400e3, gt=0
    )
    coupler_buff: Annotated[Force | None, Usual(2e3, 20e6)] = option(
        None, "largest buff of all couplers, a magnitude", example=400e3, gt=0
    )
    acceleration: Annotated[Acceleration | None, Usual(0.005, 20)] = option(
        None, "largest acceleration of vehicle 0, a magnitude", example=1.2, gt=0
    )
    jerk: Annotated[Jerk | None, Usual(0.005, 500)] = option(
        None, "largest change of vehicle 0's mean acceleration from one second to the next", example=0.8, gt=0
    )
    real_time: Time | None = option(
        None, "largest lateness of a tick against the rate, in a run of nodes with a rate", example=0.05, gt=0
    )
    brake_interventions: int | None = option(
        None, "largest number of brake interventions of the supervisor", example=0, ge=0
    )
    requirements: dict[RequirementName, RequirementText] | None = option(
        None, "formulas in signal temporal logic by name", example={"no_overspeed": "G (speed <= limit + 1 km/h)"}
    )
    tracking: TrackingLimits = option(TrackingLimits(), "limits of the outcome of tracking")


class Expectation(SiModel):
    """Expected verdict of a scenario as it is, without changes: the key ``expect`` of a file or a variant."""

    verdict: Literal["passed", "failed", "aborted", "none"] = Field(
        description="verdict of the run; aborted: a node fails during the run; none: the scenario has no criteria"
    )
    criteria: tuple[str, ...] = option((), "criteria and requirements that fail", example=("stop_window",))
    because: str = option(
        "", "cause of a failed or missing verdict, in one sentence", example="The gains are those of a heavy train."
    )

    @model_validator(mode="after")
    def _has_its_cause(self) -> "Expectation":
        """Check that a failed verdict names its criteria, and that every other verdict but passed has a cause."""
        if (self.verdict == "failed") != bool(self.criteria):
            remedy = "name the criteria that fail" if self.verdict == "failed" else "remove criteria"
            raise ValueError(f"expected verdict {self.verdict}: {remedy}")
        if (self.verdict == "passed") == bool(self.because):
            remedy = "remove because" if self.because else "give the cause with because"
            raise ValueError(f"expected verdict {self.verdict}: {remedy}")
        return self

    @property
    def text(self) -> str:
        """Verdict, failed criteria and cause in one line."""
        names = f" ({', '.join(self.criteria)})" if self.criteria else ""
        return f"{self.verdict}{names}{': ' if self.because else ''}{self.because}"
