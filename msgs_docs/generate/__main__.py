"""Write every page and schema that is generated from the code.

    python -m msgs_docs.generate                    text of all pages, and the JSON Schemas
    python -m msgs_docs.generate --check            list files older than the code; exit status 1 if any
    python -m msgs_docs.generate --site             build the site into site/, warnings are errors
    python -m msgs_docs.generate --links            check every external link of the pages; needs a network
    python -m msgs_docs.generate --measure [NAME]   first make the runs of law pages or tables; default: all

Start it in the top folder of the repository.  Tables: `faults`, `hazards`, `random_runs`, `left_out`,
`any_law`, `swaps`, `leaderboard`, `gallery`; `any_law:SCENARIO` runs one scenario and keeps the other rows.
``--measure`` of all pages takes an hour on two cores.
"""

import argparse
import sys
import tempfile
from pathlib import Path
from typing import Any

from msgs_docs.generate import (
    any_law_page,
    equation_page,
    fault_page,
    gallery_page,
    hazard_page,
    left_out_page,
    node_page,
    random_runs,
    reference_pages,
    site,
    swap_cells,
    topic_page,
)
from msgs_docs.generate.equation_page import EQUATION_TABLES, problems
from msgs_docs.generate.law_pages.measure import command, measure_components
from msgs_docs.generate.law_pages.pages import Component, Measured, components, demo_of, index, page
from msgs_docs.generate.rows import read_rows, write_rows
from plant_sim.input_error import close_match
from train_ato.api.progress import share_bar
from train_ato.cli.params import node_parameters, parameter_file
from train_ato.scenario.scenario import load_scenario
from train_ato.scenario.setup import prepare

ROOT = Path(__file__).resolve().parents[2]
LAWS = ROOT / "msgs_docs" / "laws"
MEASURED = LAWS / "measured.json"
CHECKED = (fault_page, hazard_page, random_runs, left_out_page)
"""Pages with a table of runs that can be older than the code."""
TABLES = {module.NAME: module.measure for module in (*CHECKED, any_law_page, swap_cells, gallery_page)}
"""Measurement of a table of runs by name of its page."""
TABLES[any_law_page.LEADERBOARD_NAME] = any_law_page.measure_leaderboard


def law_pages(measured: Measured) -> dict[Path, str]:
    """Return the text of every law page by file."""
    pages = {LAWS / f"{component.page}.md": page(component, measured) for component in components()}
    return {LAWS / "README.md": index(measured), **pages}


def generated() -> dict[Path, str]:
    """Return the text of every generated file by path."""
    return {
        ROOT / topic_page.PAGE: topic_page.page(),
        **{ROOT / module.PAGE: module.page(ROOT) for module in (*CHECKED, equation_page, any_law_page)},
        ROOT / node_page.PAGE: node_page.page(ROOT / node_page.PAGE),
        ROOT / node_page.REQUIREMENT_PAGE: node_page.requirement_page(ROOT / node_page.REQUIREMENT_PAGE),
        **{
            ROOT / "config" / f"{name}.yaml": parameter_file(node_parameters(prepare(*load_scenario(name))))
            for name in ("demo", "xuzhou_metro")
        },
        **{reference_pages.schema_path(kind): reference_pages.schema_text(kind) for kind in reference_pages.MODELS},
        **law_pages(read_rows(MEASURED)),
    }


def stale(files: dict[Path, str]) -> list[str]:
    """Return one line per generated file that is missing or older than the code."""
    lines = []
    for path, text in files.items():
        if not path.is_file():
            lines.append(f"{path.relative_to(ROOT)}: is missing; run python -m msgs_docs.generate")
        elif path.read_text(encoding="utf-8") != text:
            lines.append(f"{path.relative_to(ROOT)}: is older than the code; run python -m msgs_docs.generate")
    return lines


def unmeasured(measured: Measured) -> list[str]:
    """Return one line per component without current measured rows or figure, and per leftover file."""
    lines = []
    for component in components():
        runs = demo_of(component.kind, component.name).runs
        rows = [(row["run"], row["command"]) for row in measured.get(component.key, [])]
        remedy = f"run python -m msgs_docs.generate --measure {component.page}"
        if rows != [(label, command(case)) for label, case in runs.items()]:
            lines.append(f"{component.key}: its demonstration runs are not measured; {remedy}")
        if not (LAWS / f"{component.page}.png").is_file():
            lines.append(f"{component.key}: its figure is missing; {remedy}")
    known = {component.page for component in components()} | {"README", "measured"}
    leftover = [path for path in sorted(LAWS.iterdir()) if path.stem not in known]
    return lines + [f"{path.relative_to(ROOT)}: no component has this name; remove the file" for path in leftover]


def chosen(names: list[str]) -> list[Component]:
    """Return the components of the named pages; of all pages for an empty list."""
    known = {component.page: component for component in components()}
    for name in names:
        if name not in known:
            raise ValueError(f"--measure {name}: no such page{close_match(name, known)}; pages: {', '.join(known)}")
    return [known[name] for name in names or known]


def measure_pages(names: list[str]) -> None:
    """Run the demonstrations of the named pages; write their figures and table rows."""
    part = f"{any_law_page.NAME}:"
    scenarios = [name.removeprefix(part) for name in names if name.startswith(part)]
    pages = [name for name in names if name not in TABLES and not name.startswith(part)]
    wanted = chosen(pages) if pages or not names else []
    if scenarios:
        any_law_page.measure(ROOT, scenarios)
    for name, measure_table in TABLES.items():
        if not names or name in names:
            measure_table(ROOT)
    if not wanted:
        return
    LAWS.mkdir(parents=True, exist_ok=True)
    measured: dict[str, Any] = dict(read_rows(MEASURED))
    with share_bar("demonstration runs") as report:
        measured |= measure_components(wanted, LAWS, report)
    write_rows(MEASURED, dict(sorted(measured.items())), 2)


def main(arguments: list[str] | None = None) -> int:
    """Write or check the generated files; return the exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m msgs_docs.generate", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--check", action="store_true", help="list files older than the code, write nothing")
    parser.add_argument("--measure", nargs="*", metavar="NAME", help="run demonstrations first; default: all")
    parser.add_argument("--site", action="store_true", help="build the site, which needs the extra docs")
    parser.add_argument("--links", action="store_true", help="check every external link of the pages, over the network")
    options = parser.parse_args(arguments)
    if options.site or options.links:
        try:
            if options.links:
                with tempfile.TemporaryDirectory() as folder:
                    return site.build(ROOT, Path(folder, "links"), "linkcheck")
            status = site.build(ROOT, ROOT / site.SITE)
        except ValueError as error:
            parser.error(str(error))
        sys.stdout.write("" if status else f"{ROOT / site.SITE / 'index.html'}\n")
        return status
    if options.measure is not None:
        try:
            measure_pages(options.measure)
        except ValueError as error:
            parser.error(str(error))
    files = generated()
    if options.check:
        lines = stale(files) + unmeasured(read_rows(MEASURED))
        lines += [line for module in (*CHECKED, gallery_page) for line in module.unmeasured(ROOT)]
        lines += [line for table in EQUATION_TABLES for line in problems(table, ROOT)]
        sys.stdout.write("".join(f"{line}\n" for line in lines))
        return 1 if lines else 0
    for path, text in files.items():
        path.write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
