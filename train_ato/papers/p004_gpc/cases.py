"""Runs of the CRH380A as three power units for paper 004: 286 km for the figures of the paper, else short."""

from typing import Any

from train_ato.papers.claims import Case
from train_ato.papers.paper_runs import read_paper_runs

SAMPLINGS = (0.2, 0.4, 0.6, 0.8, 1.0, 1.2, 1.6)
"""Sampling periods of the law [s]."""
WEIGHTS = (0.001, 0.01, 1.0, 10.0)
"""Values of lambda at 0.4 s, beside 0.1 [s²]."""
JUMP = 100.0
"""Time of the jump of the variant `jump` [s]."""
SHORT = "crh380a_gpc:short"
LAWS, TRAINS, SINGLE, PRINTED_FORMS = read_paper_runs(__package__)


def _gpc(**parameters: Any) -> Case:
    return Case(SHORT, {**LAWS["gpc"][1], "laws": {"gpc": parameters}})


CASES = (
    SINGLE
    | {
        f"{key} {train}": Case(f"{SHORT}{variants}", changes)
        for key, (_, changes) in LAWS.items()
        for train, (_, variants) in TRAINS.items()
    }
    | {f"Ts {sampling}": _gpc(sampling=sampling) for sampling in SAMPLINGS}
    | {f"Ts {sampling} held": _gpc(sampling=sampling, beyond_horizon="hold") for sampling in SAMPLINGS}
    | {f"Ts 0.4 lambda {weight}": _gpc(sampling=0.4, command_weight=weight) for weight in WEIGHTS}
)
