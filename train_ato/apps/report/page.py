"""Page as one HTML file without network access: text, tables, figures and the Bokeh library."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from train_ato.apps.report.style import Figure
from train_ato.apps.report.verdict_rows import CriterionCells, VerdictText

HERE = Path(__file__).parent


@dataclass(frozen=True)
class Placed:
    """Figure on the page with heading and caption."""

    figure: Figure
    heading: str
    caption: str


@dataclass(frozen=True)
class PageSection:
    """Figures under one title; ``anchor`` is the target of the navigation; ``verdict``: on the first screen."""

    anchor: str
    title: str
    placed: list[Placed]


@dataclass(frozen=True)
class ReportPage:
    """Text and tables of a page.

    Attributes
    ----------
    title, subtitle
        Of the page.
    warnings
        Lines at the top, for example on a failed run.
    runs
        Name and colour of every run, one column of the tables each; no colour for a single run.
    facts
        Title and one text per run.
    groups
        Groups of the summary: title and rows with one text per run.
    events
        Per run: time as text, colour, kind, description.
    left_out
        Figures without data, and the reason.
    verdicts, criteria, best
        First screen: verdict of every run; criteria with one cell per run; the best run and the reason.
    marks
        Per key of the summary and run: True for the best value, and the difference from the best as text.
    stops
        Per run: rows of the stops as texts.
    """

    title: str
    subtitle: str
    warnings: list[str]
    runs: list[tuple[str, str]]
    facts: list[tuple[str, list[str]]]
    groups: list[tuple[str, list[Any]]]
    events: list[tuple[str, list[tuple[str, str, str, str]]]]
    left_out: list[tuple[str, str]]
    readings: list[tuple[str, str]] = field(default_factory=list)
    hours: bool = False
    version: str = ""
    verdicts: list[VerdictText] = field(default_factory=list)
    criteria: list[CriterionCells] = field(default_factory=list)
    best: str = ""
    marks: dict[str, list[tuple[bool, str]]] = field(default_factory=dict)
    stops: list[tuple[str, list[list[str]]]] = field(default_factory=list)

    @property
    def colours(self) -> dict[str, str]:
        """Colour of every run by its name."""
        return dict(self.runs)


MARKS = {"passed": "✓ passed", "failed": "✗ failed", "incomplete": "not evaluated", "none": ""}
"""Texts of the states of a criterion."""


def render(page: ReportPage, sections: list[PageSection]) -> str:
    """Return the HTML of a page."""
    from bokeh.document import Document
    from bokeh.embed import components
    from bokeh.resources import Resources
    from bokeh.settings import settings
    from jinja2 import Environment, FileSystemLoader
    from markupsafe import Markup

    figures = [placed.figure for section in sections for placed in section.placed]
    document = Document()
    for figure in figures:
        columns = next((part.ncols for part in figure.above if part.__class__.__name__ == "Legend"), 1)
        figure.tags = [[figure.min_border_left, figure.min_border_right, figure.height, columns]]  # for page.js
    with document.models.freeze():  # otherwise Bokeh searches all figures again for every added one
        for figure in figures:
            document.add_root(figure)
    settings.perform_document_validation.set_value(False)  # a sixth of the time of the page
    try:
        script, places = components(tuple(figures)) if figures else ("", ())
    finally:
        settings.perform_document_validation.unset_value()
    library = Resources(mode="inline", components=["bokeh"]).render_js() if figures else ""
    divided, rest = [], iter(places)
    for section in sections:
        blocks = [(placed.heading, placed.caption, placed.figure.id, Markup(next(rest))) for placed in section.placed]
        divided.append((section.anchor, section.title, blocks))
    files = Environment(loader=FileSystemLoader(HERE), autoescape=True, trim_blocks=True, lstrip_blocks=True)
    return files.get_template("page.html").render(
        page=page,
        marks=MARKS,
        sections=divided,
        script=Markup(script),
        library=Markup(library),
        style=Markup((HERE / "page.css").read_text(encoding="utf-8")),
        behaviour=Markup((HERE / "page.js").read_text(encoding="utf-8")),
    )
