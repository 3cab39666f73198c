"""The ``criteria:`` block of a scenario: requirements on a run, each optional."""

from __future__ import annotations

from pydantic import Field

from plant_sim.units import Acceleration, Force, Jerk, Length, SiModel, Speed, Time


class Criteria(SiModel):
    """Requirements on a run; the evaluation is in :mod:`train_ato.loop.verdict`.

    A criterion is a largest permitted magnitude. A missing one is not evaluated.
    """

    stop_window: Length | None = Field(
        None, gt=0, description="largest distance of the front from the target at every stop of the profile"
    )
    arrival_delay: Time | None = Field(
        None, ge=0, description="largest delay of the arrival at a stop against the profile"
    )
    overspeed: Speed | None = Field(
        None, ge=0, description="largest speed above the lowest speed limit under the train"
    )
    speed_error_rms: Speed | None = Field(
        None, gt=0, description="root mean square of the speed error over the evaluation"
    )
    speed_error: Speed | None = Field(
        None, gt=0, description="largest speed error of the whole run, the braking to the stop included"
    )
    position_error: Length | None = Field(None, gt=0, description="largest position error over the evaluation")
    coupler_draft: Force | None = Field(None, gt=0, description="largest draft of all couplers")
    coupler_buff: Force | None = Field(None, gt=0, description="largest buff of all couplers, a magnitude")
    acceleration: Acceleration | None = Field(None, gt=0, description="largest acceleration of vehicle 0, a magnitude")
    jerk: Jerk | None = Field(
        None, gt=0, description="largest change of vehicle 0's mean acceleration from one second to the next"
    )
    brake_interventions: int | None = Field(
        None, ge=0, description="largest number of brake interventions of the supervisor"
    )
