"""Runs of the heavy-haul train for paper 000: its own setting, and one with lag 0.4 s and delay 0.8 s.

Every case has the 2674 s of the driver's run and a tick of 0.05 s (printed PID: 0.01 s), unless a shorter run suffices.
"""

from typing import Any

from train_ato.papers.claims import Case, read_paper_runs

DURATION = 2674
"""Length of the driver's run [s]."""
PERIOD = 0.05
"""Tick of the tables [s]."""
SHORT = 600
"""Start from rest to 70 km/h, sufficient for the detection of an unstable loop [s]."""
LIMIT_DELAYS = (0.05, 0.1, 0.15, 0.2, 0.4)
"""Pure delays below and above the limit of the printed law, 0.17 s [s]."""

LAWS, LAGGED_TRAINS, SINGLE, PRINTED_FORMS = read_paper_runs(__package__)
LAGGED_LAWS = {key: LAWS[key] for key in ("twin_pid", "twin_smc", "twin_smc_ndo", "predicted")}
IDEAL_LAWS = {key: law for key, law in LAWS.items() if key not in LAGGED_LAWS}
PRINTED_NETWORK: dict[str, Any] = LAWS["rbf"][1]["laws"]["rbf_smc"]
"""The printed network has no output outside its basis functions, and no limit of its weights."""


def _case(setting: str, law: str, variants: str = "", **more: Any) -> Case:
    return Case(f"daqin_heavy_haul:{setting}+paper_rate{variants}", {**LAWS[law][1], **more})


def _cases() -> dict[str, Case]:
    bare: dict[str, Any] = {"compensation": "none", "duration": SHORT}
    cases = {
        **SINGLE,
        **{key: _case("ideal", key) for key in IDEAL_LAWS},
        **{f"{key} disturbed": _case("ideal", key, "+disturbed") for key in IDEAL_LAWS},
        **{
            f"{key} {train}": _case("twin", key, variants)
            for key in LAGGED_LAWS
            for train, (_, variants) in LAGGED_TRAINS.items()
        },
        **{
            f"smc delay {delay}": _case("ideal", "smc", duration=SHORT, links={"command": {"delay": delay}})
            for delay in LIMIT_DELAYS
        },
        "pid lag": _case("twin", "pid", **bare, links={"command": {"delay": 0.0}}),
        **{f"{key} lagged": _case("twin", key, **bare) for key in ("pid", "rbf_ndo", "rbf_ks_ndo")},
    }
    whole = {key: Case(case.scenario, {"duration": DURATION, **case.changes}) for key, case in cases.items()}
    longest = sorted(whole, key=lambda key: -whole[key].changes["duration"] / whole[key].changes.get("tick", PERIOD))
    return {key: whole[key] for key in longest}


CASES = _cases()
