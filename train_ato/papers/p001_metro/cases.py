"""Runs of the metro train for paper 001: its own setting, and one with lag 0.4 s and delay 0.3 s.

The gains of the laws of this project were chosen on two runs: `disturbed`, and the same with a true lag of 0.45 s and a
delay of 0.4 s. The mismatch, the slower actuator and the delay of 1 s are held out. The PID gains are from an
independent optimisation.
"""

from typing import Any

from train_ato.papers.claims import Case, read_paper_runs

INERTIA = 192_170.0
"""Mass including rotating masses [kg]."""
SWEEP = (0.2, 0.5, 0.75)
"""Delays between those of the table [s]."""
ESO = {"observer": "eso", "observers": {"eso": {"omega": 3.0}}}
LAWS, TRAINS, SINGLE, PRINTED_FORMS = read_paper_runs(__package__)
_FAST = SINGLE["ideal rbf fast no noise 10 ms"].changes
FAST_PHI = _FAST["laws"]["rbf_switching_smc"]["phi"]
RATE = _FAST["laws"]["rbf_switching_smc"]["eta"] * _FAST["tick"]
"""Surface [m/s] and learning rate of the paper, per sample, of the corrected network with an ideal actuator."""


def _observed(law: str, variant: str, **more: Any) -> Case:
    """Return a run of a law; its predictor has an observer beside a disturbance."""
    changes = LAWS[law][1]
    observer = ESO if variant and changes["compensation"] == "predictor" else {}
    return Case(f"xuzhou_metro{variant}", {**changes, **observer, **more})


CASES = {
    **{f"{key} {train}": _observed(key, variant) for key in LAWS for train, (_, variant) in TRAINS.items()},
    **SINGLE,
    **{
        f"sweep {delay}": _observed("tanh_predictor", ":disturbed", links={"command": {"delay": delay}})
        for delay in SWEEP
    },
}
