"""Requests to the ATO during a run: engage, disengage, reset.

A scenario plans them, or a service call of the node ``controller`` makes them during the run.  The diagnostics of the
controller contain each accepted request, so that the run can be repeated from its log.
"""

from typing import Literal, get_args

from pydantic import Field

from plant_sim.si_model import SiModel
from plant_sim.units import Time

KEY = "ato_request"
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
    for request in REQUESTS:
        if request == text:
            return request
    raise ValueError(f"{KEY} '{text[:60]}': not written by this version; open the run with its own version")
