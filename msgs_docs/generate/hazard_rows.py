"""Rows of the hazard table: unsafe control actions, and hazards without a monitor."""

from __future__ import annotations

from msgs_docs.generate.hazard_commands import BRAKE, DEMAND, EMERGENCY, TRACTION
from msgs_docs.generate.hazard_inputs import MANAGEMENT, REPORTS
from msgs_docs.generate.hazard_table import HazardRow, OpenHazard

ROWS: tuple[HazardRow, ...] = (*TRACTION, *BRAKE, *DEMAND, *EMERGENCY, *REPORTS, *MANAGEMENT)
"""Rows of the table."""

OPEN: tuple[OpenHazard, ...] = (
    OpenHazard(
        "H2",
        "The emergency brake has half its force and the electric brake none: less than the factor Kdry covers.",
        ("plant.mismatch={electric_brake_scale: 0, brake_scale: 0.5}",),
    ),
)
"""Hazards without a monitor, found in this analysis."""
