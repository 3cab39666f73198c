"""No compensation: measured state, reference and feed-forward of the present time.

The delay of the command is not compensated. Suitable for trains without delay, and for laws that compensate the delay
by themselves (`funnel`, `gpc`).

Needs: nothing; any law, any train.
"""

from typing import ClassVar

from train_ato.control.compensation.base import CompensationBase
from train_ato.control.contract import NoParameters


class NoCompensation(CompensationBase):
    """No compensation: state, reference and feed-forward of the present time."""

    Parameters: ClassVar[type] = NoParameters
