"""Runs of the freight train for paper 002: the printed setting at 1 ms, and a realistic setting over the delay."""

from collections.abc import Mapping

from train_ato.papers.claims import Calculation, Case, read_paper_runs
from train_ato.papers.p002_freight.observer_trials import nominal_settling, observer_accuracy

DELAYS: Mapping[float, str] = {0.3: "+delay_0_3", 0.6: "", 0.8: "+delay_0_8", 1.0: "+delay_1_0"}
"""Variant of the scenario by command delay [s]."""

RATIOS = (0.75, 0.9, 1.1, 1.25)
"""Ratio of true to modelled delay, for a modelled delay of 0.8 s."""

OBSERVER_TICKS: Mapping[str, tuple[float, float, float]] = {
    "0.01 ms": (1e-5, 0.1, 0.06), "0.1 ms": (1e-4, 0.5, 0.3), "1 ms": (1e-3, 30.0, 0.5), "10 ms": (1e-2, 30.0, 0.5),
    "50 ms": (5e-2, 30.0, 0.5),
}  # fmt: skip
"""Tick, duration and begin of the evaluation [s] by sampling time."""

LAWS, _, SINGLE, PRINTED_FORMS = read_paper_runs(__package__)


def _delayed(law: str, ratio: float) -> Case:
    """Return a run with another delay than that of the model."""
    delays = {"links": {"command": {"delay": 0.8 * ratio}}, "model": {"delay": 0.8, "lag": 0.4}}
    return Case("freight_consensus:realistic+delay_0_8", {**LAWS[law][1], **delays})


CASES: dict[str, Case | Calculation] = {
    **{
        f"observers {key}": Calculation(observer_accuracy, {"tick": tick, "duration": duration, "settle": settle})
        for key, (tick, duration, settle) in OBSERVER_TICKS.items()
    },
    **SINGLE,
    **{
        f"{key} {delay}": Case(f"freight_consensus:realistic{variant}", changes)
        for key, (_, changes) in LAWS.items()
        for delay, variant in DELAYS.items()
    },
    **{f"{key} x{ratio}": _delayed(key, ratio) for key in ("unit", "common", "common damped") for ratio in RATIOS},
    **{
        f"gain {gain:g} from {error:g} m": Calculation(nominal_settling, {"gain": gain, "error": error, "rate": -12.0})
        for gain in (1.9, 50.0)
        for error in (108.0, 748.0)
    },
}
