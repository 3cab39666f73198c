"""Diagnostics of compiled ticks are the messages of their numbers, and the totals of a run need few of them."""

from __future__ import annotations

from train_ato.loop.recording import Recording
from train_ato.loop.repeated_reports import RepeatedReport
from train_ato.messages.types import Diagnostic

SECOND = 1_000_000_000
STAMPS = [SECOND, 2 * SECOND, 3 * SECOND]
PLANT = RepeatedReport(Diagnostic(SECOND, "plant", 0, "running", {"energy_traction": "1.5", "law": "pid"}), STAMPS,
                       {"energy_traction": [1.5, 2.5, 0.1]})  # fmt: skip
PROFILE = RepeatedReport(Diagnostic(SECOND, "profile", 1, "following", {"replans": "2"}), STAMPS)
START = Diagnostic(0, "plant", 0, "running", {"energy_traction": "0.0", "law": "smc"})
RECORDING = Recording(kept_reports=(START, PLANT, PROFILE))


def test_messages_are_in_the_order_of_the_ticks() -> None:
    """Breaks if the messages of a node are not between those of the others, or with a number of another stamp."""
    assert RECORDING.reports == (
        START,
        *(
            Diagnostic(stamp, node, level, text, values)
            for stamp, energy in zip(STAMPS, ("1.5", "2.5", "0.1"), strict=True)
            for node, level, text, values in (
                ("plant", 0, "running", {"energy_traction": energy, "law": "pid"}),
                ("profile", 1, "following", {"replans": "2"}),
            )
        ),
    )


def test_totals_and_series_are_those_of_the_messages() -> None:
    """Breaks if the last message of a span is missing in the totals, or a number or text in the series."""
    alone = Recording(kept_reports=RECORDING.reports)
    assert RECORDING.totals == alone.totals == {"energy_traction": 0.1, "replans": 2.0}
    for node in ("plant", "profile"):
        one, other = RECORDING.diagnostics[node], alone.diagnostics[node]
        assert one.time.tolist() == other.time.tolist()
        assert (one.level.tolist(), one.message) == (other.level.tolist(), other.message)
        assert {key: one.texts(key) for key in one.values} == {key: other.texts(key) for key in other.values}
