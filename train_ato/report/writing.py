"""Writing the report of one run, or of several side by side."""

from __future__ import annotations

from pathlib import Path

from train_ato.report.digest import Digest
from train_ato.report.events import KINDS
from train_ato.report.page import Page, render
from train_ato.report.summary_rows import filled_groups
from train_ato.version import VERSION

TITLES = {
    "speed": "speed",
    "speed_error": "speed error",
    "position_error": "position error",
    "forces": "forces",
    "unit_forces": "force of every power unit",
    "couplers": "force along the train",
    "coupler_extremes": "coupler extremes",
    "disturbance": "disturbance",
    "delay": "delay",
    "pipe": "brake pipe",
    "shoes": "shoe force along the train",
    "shoe_force": "shoe force of the whole train",
    "energy": "energy",
}
"""Figures as they are called where they are missing."""


def write_run(digest: Digest, path: Path) -> int:
    """Write the page of one run and return its size in bytes."""
    from train_ato.report.run_page import run_sections

    sections, linked = run_sections(digest)
    summary = digest.summary
    page = Page(
        title=str(summary.get("scenario") or digest.label),
        subtitle=digest.subtitle,
        warnings=warnings_of(digest),
        runs=[("value", "")],
        facts=[(title, [text]) for title, text in digest.facts.items()],
        groups=filled_groups([summary]),
        events=[("List", event_rows(digest))],
        left_out=[(TITLES[name], reason) for name, reason in digest.left_out.items()],
        readings=linked.readings,
        hours=linked.hours,
        version=VERSION,
    )
    return write(render(page, sections), path)


def write_comparison(digests: list[Digest], path: Path) -> int:
    """Write the page of several runs side by side and return its size in bytes."""
    from train_ato.report.comparison_lines import run_colours
    from train_ato.report.comparison_page import comparison_sections

    sections, linked = comparison_sections(digests)
    scenarios = {str(digest.summary.get("scenario", "")) for digest in digests} - {""}
    page = Page(
        title=f"{scenarios.pop() if len(scenarios) == 1 else 'Several scenarios'}: {len(digests)} runs side by side",
        subtitle=digests[0].subtitle if len({digest.subtitle for digest in digests}) == 1 else "",
        warnings=[warning for digest in digests for warning in warnings_of(digest, f"{digest.label}: ")],
        runs=list(zip([digest.label for digest in digests], run_colours(len(digests)), strict=True)),
        facts=_facts_side_by_side(digests),
        groups=filled_groups([digest.summary for digest in digests]),
        events=[(digest.label, event_rows(digest)) for digest in digests if digest.events],
        left_out=_missing_in_all(digests),
        readings=linked.readings,
        hours=linked.hours,
        version=VERSION,
    )
    return write(render(page, sections), path)


def _facts_side_by_side(digests: list[Digest]) -> list[tuple[str, list[str]]]:
    titles = dict.fromkeys(title for digest in digests for title in digest.facts)
    return [("run", [digest.label for digest in digests])] + [
        (title if title != "run" else "folder", [digest.facts.get(title, "–") for digest in digests])
        for title in titles
    ]


def _missing_in_all(digests: list[Digest]) -> list[tuple[str, str]]:
    """Return the figures that no run can fill, with the reason of the first that says one."""
    drawn = [digest for digest in digests if digest.lines]
    return [
        (TITLES[name], next(digest.left_out[name] for digest in drawn))
        for name in (drawn[0].left_out if drawn else ())
        if name != "unit_forces" and all(name in digest.left_out for digest in drawn)
    ]


def write(text: str, path: Path) -> int:
    """Write a file whole or not at all, and return its size in bytes."""
    data = text.encode("utf-8")
    scratch = path.with_name(path.name + ".part")
    try:
        scratch.write_bytes(data)
        scratch.replace(path)
    finally:
        scratch.unlink(missing_ok=True)
    return len(data)


def warnings_of(digest: Digest, run: str = "") -> list[str]:
    """Return what a reader must know before anything else; ``run`` stands before every line."""
    status, end = str(digest.summary.get("status", "")), clock(digest.span[1])
    found = []
    if status == "failed":
        found.append(f"{run}The run failed at {end}: {digest.summary.get('failure', 'no reason recorded')}")
    elif status == "interrupted":
        found.append(f"{run}The run was interrupted at {end}; the figures cover what was recorded.")
    elif status == "killed":
        found.append(f"{run}The run was killed; its log was recovered up to {end}.")
    return found + [f"{run}{remark}" for remark in digest.remarks]


def event_rows(digest: Digest) -> list[tuple[str, str, str, str]]:
    """Return the events as a table shows them: time, colour, kind, text."""
    rows = []
    for event in digest.events:
        time = clock(event.begin) if event.end is None else f"{clock(event.begin)} – {clock(event.end)}"
        rows.append((time, KINDS[event.kind].colour, KINDS[event.kind].words, event.text))
    return rows


def clock(time: float) -> str:
    """Return a time [s] as hours, minutes and seconds."""
    tenths = round(10 * time)
    minutes, rest = divmod(tenths, 600)
    text = f"{minutes // 60}:{minutes % 60:02d}" if minutes >= 60 else str(minutes)
    return f"{text}:{rest / 10:04.1f}"
