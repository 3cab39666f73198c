"""Writing of the page of one run, or of the comparison of several runs."""

from collections import Counter
from pathlib import Path
from typing import Any

from train_ato.judge.motion_difference import MotionDifference
from train_ato.judge.protection_record import summary_events
from train_ato.judge.ranking import difference_from_best
from train_ato.log.reading import log_file
from train_ato.log.whole_file import write_whole
from train_ato.program.arguments import check_new_file
from train_ato.program.display_units import display_unit
from train_ato.program.version import VERSION
from train_ato.report import summary_rows
from train_ato.report.page_data import PageData, run_colours
from train_ato.report.quantities import KINDS, PANELS
from train_ato.report.words import COMPARISON, REPORT


def checked(runs: list[Path], page: Path | None, figures: Path | None) -> tuple[Path, tuple[str, ...]]:
    """Check the arguments of a report; return the file of the page, and the different names of the runs."""
    for run in runs:
        log_file(run)
    places = [run.resolve() for run in runs]
    twice = [run for run, place in zip(runs, places, strict=True) if places.count(place) > 1]
    if twice:
        raise ValueError(f"{twice[0]}: named twice; give different runs")
    if page is None:
        folder = runs[0] if runs[0].is_dir() else runs[0].parent
        page = folder / REPORT if len(runs) == 1 else Path(COMPARISON)
    else:
        check_new_file(page, (".html", ".htm"))
    if figures is not None and any(place.exists() and not place.is_dir() for place in (figures, *figures.parents)):
        raise ValueError(f"--figures {figures}: is a file or is inside a file; give a folder")
    return page, labels_of(places)


def labels_of(places: list[Path]) -> tuple[str, ...]:
    """Return the names of the run folders, with parent folders if names are equal."""
    folders = [place if place.is_dir() else place.parent for place in places]
    names = [folder.name for folder in folders]
    often = Counter(names)
    longer = [f"{folder.parent.name}/{folder.name}" for folder in folders]
    chosen = [long if often[name] > 1 else name for name, long in zip(names, longer, strict=True)]
    still = Counter(chosen)
    return tuple(str(place) if still[name] > 1 else name for name, place in zip(chosen, places, strict=True))


def write_page(pages: list[PageData], path: Path, *, compared: bool) -> int:
    """Write the page of one run, or that of several runs side by side.

    Parameters
    ----------
    pages
        Content of the page for each run, in the order of the columns.
    path
        File of the page; it is complete or not there.
    compared
        True for the page of several runs: a colour and a column for every run, the differences from the best value of
        each metric, and from the motion of the first run. The page of one run has its event list and all its facts.

    Returns
    -------
    int
        Size of the page [bytes].
    """
    from train_ato.report.page import render
    from train_ato.report.page_data import motion_differences
    from train_ato.report.page_sections import comparison_sections, run_sections

    data, summaries, drawn = pages[0], [data.summary for data in pages], [data for data in pages if data.curves]
    sections, linked = comparison_sections(pages) if compared else run_sections(data)
    if compared:
        titles = dict.fromkeys(title for data in pages for title in data.facts)
        warnings = [warning for data in pages for warning in warnings_of(data, f"{data.label}: ")]
        runs = list(zip([data.label for data in pages], run_colours(len(pages)), strict=True))
        facts = [("run", [data.label for data in pages])]
        facts += [(t if t != "run" else "folder", [data.facts.get(t, "–") for data in pages]) for t in titles]
        events = [(data.label, event_rows(data)) for data in pages if data.events]
        absent = {
            name: next(data.left_out[name] for data in drawn)
            for name in (drawn[0].left_out if drawn else ())
            if name != "unit_forces" and all(name in data.left_out for data in drawn)
        }
    else:
        protection = summary_events(data.summary)
        warnings = [*warnings_of(data), *([f"{protection[0].upper()}{protection[1:]}."] if protection else [])]
        runs, facts = [("value", "")], [(title, [text]) for title, text in data.facts.items()]
        events, absent = [("List", event_rows(data))], data.left_out
    differences = motion_differences(drawn) if compared else {}
    page = {
        "title": comparison_title(pages) if compared else run_title(data),
        "subtitle": data.subtitle if len({data.subtitle for data in pages}) == 1 else "",
        "warnings": warnings,
        "runs": runs,
        "facts": facts,
        "groups": summary_rows.filled_groups(summaries) if compared else summary_rows.run_groups(data.summary),
        "events": events,
        "left_out": [(PANELS[name][1], reason) for name, reason in absent.items()],
        "readings": linked.readings,
        "hours": linked.hours,
        "version": VERSION,
        "verdicts": summary_rows.verdict_texts(pages),
        "criteria": summary_rows.criterion_cells(pages),
        "best": summary_rows.best_text(pages),
        "marks": _marks(summaries) if compared else {},
        "stops": [(data.label if compared else "", stop_cells(data.summary)) for data in pages],
        "differences": [(label, one.line, difference_cells(one)) for label, one in differences.items()],
    }
    write_whole(path, render(page, sections))
    return path.stat().st_size


def stop_cells(summary: dict[str, Any]) -> list[list[str]]:
    """Return number, place, planned and actual arrival, delay [s] and error [m] of every stop as texts."""
    rows = []
    per_km, metre = display_unit("km")[1], display_unit("m")[1]
    for number, stop in enumerate(summary.get("stops") or (), start=1):
        arrival = stop["arrival_s"]
        times = [short_clock(stop["planned_s"]), "–" if arrival is None else short_clock(arrival)]
        late = "–" if arrival is None else f"{stop['delay_s']:+.1f}".replace("-", "−")
        error = "no stop" if stop["beyond_m"] is None else f"{metre * stop['beyond_m']:+.3f}".replace("-", "−")
        rows.append([str(number), stop.get("post") or f"{per_km * stop['km']:.3f}", *times, late, error])
    return rows


def difference_cells(found: MotionDifference) -> list[list[str]]:
    """Return place, both arrivals, and the differences of arrival [s] and place [m] of every stop as texts."""
    rows = []
    per_km, metre = display_unit("km")[1], display_unit("m")[1]
    for stop in found.stops:
        km, *arrivals, late, farther = stop.values()
        rows.append(
            [
                f"{per_km * (km or 0.0):.3f}",
                *("–" if time is None else short_clock(time) for time in arrivals),
                "–" if late is None else f"{late:+.1f}".replace("-", "−"),
                "–" if farther is None else f"{metre * farther:+.3f}".replace("-", "−"),
            ]
        )
    return rows


def run_title(data: PageData) -> str:
    """Return scenario and laws of a run."""
    laws = data.facts.get("law")
    return f"{data.summary.get('scenario') or data.label}{f': {laws}' if laws else ''}"


def comparison_title(pages: list[PageData]) -> str:
    """Return scenario and number of runs as a title, with all laws if a run changed its law."""
    scenarios = {str(data.summary.get("scenario", "")) for data in pages} - {""}
    changed = [f"{data.label}: {text}" for data in pages if "→" in (text := data.facts.get("law", ""))]
    head = f"{scenarios.pop() if len(scenarios) == 1 else 'Several scenarios'}: {len(pages)} runs side by side"
    return f"{head} ({'; '.join(changed)})" if changed else head


def _marks(summaries: list[dict[str, Any]]) -> dict[str, list[tuple[bool, str]]]:
    """Return per metric and run: True for the best value, and the difference from it as text."""
    marks = {}
    for _, rows in summary_rows.filled_groups(summaries):
        for row, _ in rows:
            found = [difference_from_best(row.key, summary, summaries) for summary in summaries]
            if any(difference is not None for difference in found):
                marks[row.key] = [
                    (difference == 0.0, summary_rows.difference_text(row, difference)) for difference in found
                ]
    return marks


def warnings_of(data: PageData, run: str = "") -> list[str]:
    """Return the warnings of a run; ``run`` precedes every line."""
    status, end = str(data.summary.get("status", "")), short_clock(data.span[1])
    found = []
    if status == "failed":
        found.append(f"{run}The run failed at {end}: {data.summary.get('failure', 'no reason recorded')}")
    elif status == "interrupted":
        found.append(f"{run}The run was interrupted at {end}; the figures show the recorded part.")
    elif status == "killed":
        found.append(f"{run}The run was killed; its log was recovered up to {end}.")
    return found + [f"{run}{remark}" for remark in data.remarks]


def event_rows(data: PageData) -> list[tuple[str, str, str, str]]:
    """Return the rows of the event table: time, colour, kind, text."""
    rows = []
    for event in data.events:
        time = (
            short_clock(event.begin) if event.end is None else f"{short_clock(event.begin)} – {short_clock(event.end)}"
        )
        rows.append((time, KINDS[event.kind].colour, KINDS[event.kind].words, event.text))
    return rows


def short_clock(time: float) -> str:
    """Return a time [s] as text of hours, minutes and seconds."""
    tenths = round(10 * time)
    minutes, rest = divmod(tenths, 600)
    text = f"{minutes // 60}:{minutes % 60:02d}" if minutes >= 60 else str(minutes)
    return f"{text}:{rest / 10:04.1f}"
