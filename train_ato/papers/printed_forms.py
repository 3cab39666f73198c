"""Table of the printed forms of a paper beside the forms of this project, with the errors of both."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from train_ato.papers.claims import CaseTable, Result, Results
from train_ato.papers.tracking import largest_position_error, largest_speed_error, moving, rms, speed_error, written


@dataclass(frozen=True)
class PrintedForm:
    """An equation that the paper prints in another form than the default of the law.

    Parameters
    ----------
    text
        The printed form, its equation, and the setting of both runs.
    case
        Case with the printed form.
    here
        Form of this project in the same place.
    default
        Case with that form; all else is equal.
    """

    text: str
    case: str
    here: str
    default: str


def printed_forms_table(forms: Sequence[PrintedForm]) -> CaseTable:
    """Return the table of the printed forms of a paper."""

    def rows(results: Results) -> list[tuple[str, ...]]:
        return [(form.text, errors(results[form.case]), form.here, errors(results[form.default])) for form in forms]

    heads = ("printed", "errors", "here", "errors")
    return CaseTable("printed forms: largest position error; speed error, rms and largest", heads, rows)


def errors(result: Result) -> str:
    """Return the errors of a run while moving as text, or the reason of its failure."""
    recording = result.recording
    if recording is None or result.failure:
        return result.failure or "no series"
    slow = rms(speed_error(recording)[moving(recording)])
    figures = ((largest_position_error(result), "m"), (slow, "m/s"), (largest_speed_error(result), "m/s"))
    return "; ".join(written(value, unit) for value, unit in figures)
