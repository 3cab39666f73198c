"""Diagnostics of compiled ticks are the messages of their numbers, and the totals of a run need few of them."""

from __future__ import annotations

from train_ato.loop.recording import Recording
from train_ato.loop.repeated_reports import KeptReports, RepeatedReport
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


def test_messages_of_equal_texts_are_joined_and_given_back() -> None:
    """Breaks if a joined message has another number or text, or an event is lost between equal ones."""
    values = [
        {"speed": "1.5", "count": "0", "state": "on"},
        {"speed": "0.1", "count": "0", "state": "on"},
        {"speed": "-0.0", "count": "3", "state": "on"},  # a constant number becomes a column
        {"speed": "1", "count": "3", "state": "on"},  # an integer is another text
        {"speed": "1", "count": "3", "state": "off"},
        {"speed": "1.50", "count": "3", "state": "off"},  # no number that is written like this
        {"speed": "nan", "count": "3", "state": "off"},
        *[{"speed": "nan", "count": "3", "state": "off", "changed": "{}"}] * 3,
    ]
    messages = [Diagnostic(SECOND * at, "controller", 0, "engaged", entry) for at, entry in enumerate(values)]
    kept = KeptReports()
    for message in messages:
        kept.add(message)
    found = Recording(kept_reports=kept.finish())
    assert found.reports == tuple(messages)
    assert len(kept.finish()) < len(messages)
    assert [report.stamp // SECOND for report in found.changed_reports] == [0, 2, 3, 4, 5, 6, 7, 8, 9]
    one, other = found.diagnostics["controller"], Recording(kept_reports=tuple(messages)).diagnostics["controller"]
    assert {key: one.texts(key) for key in one.values} == {key: other.texts(key) for key in other.values}
    late = KeptReports()
    for message in (messages[1], messages[0]):
        late.add(message)
    assert late.finish() == tuple(messages[:2])


def test_totals_and_series_are_those_of_the_messages() -> None:
    """Breaks if the last message of a span is missing in the totals, or a number or text in the series."""
    alone = Recording(kept_reports=RECORDING.reports)
    assert RECORDING.totals == alone.totals == {"energy_traction": 0.1, "replans": 2.0}
    for node in ("plant", "profile"):
        one, other = RECORDING.diagnostics[node], alone.diagnostics[node]
        assert one.time.tolist() == other.time.tolist()
        assert (one.level.tolist(), one.message) == (other.level.tolist(), other.message)
        assert {key: one.texts(key) for key in one.values} == {key: other.texts(key) for key in other.values}
