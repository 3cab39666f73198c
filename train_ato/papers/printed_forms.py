"""Table of the printed forms of a paper beside the forms of this project, with the errors of both."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from train_ato.papers.claims import CaseTable, Result, Results
from train_ato.papers.tracking import largest, moving, position_error, rms, speed_error, written


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
    begin
        Begin of the evaluation [s].
    """

    text: str
    case: str
    here: str
    default: str
    begin: float = 0.0


def printed_forms_table(forms: Sequence[PrintedForm]) -> CaseTable:
    """Return the table of the printed forms of a paper."""

    def rows(results: Results) -> list[tuple[str, ...]]:
        return [
            (
                form.text,
                errors(results[form.case], form.begin),
                form.here,
                errors(results[form.default], form.begin),
            )
            for form in forms
        ]

    heads = ("printed", "errors", "here", "errors")
    return CaseTable("printed forms: largest position error; speed error, rms and largest", heads, rows)


def errors(result: Result, begin: float = 0.0) -> str:
    """Return the errors of a run from ``begin`` [s] on, those of the speed while moving, or the reason of its failure.

    Returns
    -------
    str
        Largest position error, rms and largest speed error, with units.
    """
    recording = result.recording
    if recording is None or result.failure:
        return result.failure or "no series"
    late = recording.time >= begin
    place, speed = position_error(recording)[late], speed_error(recording)[late & moving(recording)]
    figures = ((largest(place), "m"), (rms(speed), "m/s"), (largest(speed), "m/s"))
    return "; ".join(written(value, unit) for value, unit in figures)
