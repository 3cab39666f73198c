"""The pages of laws, observers and compensations are those of the code, and their figures those of our own runs."""

from __future__ import annotations

import argparse
import shlex
from pathlib import Path

import pytest
from matplotlib import image

from train_ato.cli import run as run_command
from train_ato.cli.scenario_options import prepare_from
from train_ato.law_docs import __main__ as command_line
from train_ato.law_docs.__main__ import FOLDER as PLACE
from train_ato.law_docs.__main__ import chosen, read_measured, texts
from train_ato.law_docs.blocks import Block, blocks
from train_ato.law_docs.homes import HOMES, Home
from train_ato.law_docs.markup import sections
from train_ato.law_docs.measure import command, measure
from train_ato.law_docs.pages import parameter_table
from train_ato.reproduce.claims import Case
from train_ato.run_setup import prepare
from train_ato.scenario import load

BLOCKS = {block.key: block for block in blocks()}
CASES = {command(case): case for home in HOMES.values() for case in home.runs.values()}
FOLDER = Path(__file__).resolve().parents[1] / PLACE
MEASURED = read_measured(FOLDER)
PAGES = texts(MEASURED)
LARGEST_PNG = 60_000


@pytest.mark.parametrize("name", PAGES)
def test_page_is_that_of_the_code(name: str) -> None:
    """Breaks if a docstring, a parameter or a refusal changes and its page does not: python -m train_ato.law_docs."""
    assert (FOLDER / name).read_text(encoding="utf-8") == PAGES[name]


def test_no_page_is_left_over() -> None:
    """Breaks if a block is renamed or taken out and its page or figure stays."""
    figures = {f"{BLOCKS[key].page}.png" for key in HOMES}
    assert {path.name for path in FOLDER.iterdir()} == {*PAGES, *figures, "measured.json"}


@pytest.mark.parametrize("key", BLOCKS)
def test_every_block_says_what_it_does_and_needs(key: str) -> None:
    """Breaks if the docstring of a module loses its words on what the block does, or the paragraph Needs."""
    title, does, law, needs = sections(BLOCKS[key].text, {})
    assert min(map(len, (title, does))) > 20
    assert len(needs) >= len("Nothing.")
    assert law or BLOCKS[key].name == "none"


@pytest.mark.parametrize("key", BLOCKS)
def test_figure_is_there_and_small(key: str) -> None:
    """Breaks if a page has no figure, or one that swells the repository."""
    path = FOLDER / f"{BLOCKS[key].page}.png"
    assert path.stat().st_size < LARGEST_PNG
    assert min(image.imread(path).shape[:2]) > 300


def test_measured_tables_are_those_of_the_homes() -> None:
    """Breaks if a home changes and its runs were not driven again: python -m train_ato.law_docs --measure."""
    stored = {key: [(row["run"], row["command"]) for row in rows] for key, rows in MEASURED.items()}
    assert stored == {key: [(label, command(case)) for label, case in home.runs.items()] for key, home in HOMES.items()}
    assert set(HOMES) == set(BLOCKS)


@pytest.mark.parametrize("line", CASES)
def test_the_command_beside_a_figure_drives_its_run(line: str) -> None:
    """Breaks if a command on a page is refused, or means another run than the one that was measured."""
    parser = argparse.ArgumentParser()
    run_command.add_arguments(parser)
    program, name, *arguments = shlex.split(line)
    assert (program, name) == ("train-ato", "run")
    options = parser.parse_args(arguments)
    case = CASES[line]
    measured = prepare(*load(case.scenario, changes=dict(case.changes)))
    assert prepare_from(options, controller=options.controller).resolved_yaml() == measured.resolved_yaml()


def test_docstrings_become_markdown() -> None:
    """Code stays code, what is linked is linked, nothing turns into emphasis by accident."""
    title, does, law, needs = sections(
        "A law, paper 000.\n\nDoes ``this``.\n\n"
        "Per unit, x*_i of :mod:`a.smc`::\n\n    S = e' + l1 e\n\n    u = -m S\n\n"
        "* a correction to :class:`~x.Y`\n\nNeeds: a sensor.",
        {"a.smc": "smc"},
    )
    assert (title, does, needs) == ("A law, paper 000.", "Does `this`.", "A sensor.")
    assert law == (
        "Per unit, x\\*_i of [`smc`](smc.md):\n\n```text\nS = e' + l1 e\n\nu = -m S\n```\n\n* a correction to `x.Y`"
    )


def test_parameter_table_by_hand() -> None:
    """Default, unit, range and choices as declared; a bar in a meaning does not end its cell."""
    rows = parameter_table(BLOCKS["observer/cascaded"]).splitlines()
    assert "| `method` | implicit | - | implicit, levant | implicit signs, or Levant's differentiators |" in rows
    assert "| `unmatched` | true | - | true, false | estimate the speed offset d1 as well |" in rows
    assert "| `jerk_offset` | 100 | m/s³ | 1e-06 ... 1e+06 | bound of \\|d1''\\|, levant only |" in rows


def short(monkeypatch: pytest.MonkeyPatch, **changes: object) -> Block:
    block = BLOCKS["controller/pid"]
    runs = {
        name: Case("xuzhou_metro", {"duration": 40, **changes, "seed": seed}) for seed, name in enumerate(("a", "b"))
    }
    monkeypatch.setitem(HOMES, block.key, Home(runs))
    return block


def test_measuring_drives_and_draws(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Breaks if the command no longer makes a table and a small figure out of runs."""
    block = short(monkeypatch)
    shares: list[float] = []
    found = measure([block], tmp_path, lambda share, _: shares.append(share))
    assert shares == [0.5, 1.0]
    assert [row["run"] for row in found[block.key]] == ["a", "b"]
    assert 0.0 < found[block.key][0]["speed_rmse_kmh"] < 1.0
    assert (tmp_path / "pid.png").stat().st_size < LARGEST_PNG


def test_a_run_that_fails_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Breaks if a figure of half a run is put on a page."""
    block = short(monkeypatch, controller="smcc")
    with pytest.raises(OSError, match=r"train-ato run xuzhou_metro .*unknown controller 'smcc'"):
        measure([block], tmp_path, lambda *_: None)
    assert not list(tmp_path.iterdir())


def test_a_page_that_is_not_there_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    """One line, exit status 2, nothing written."""
    with pytest.raises(ValueError, match=r"--measure smcc: no such page \(did you mean 'smc'\?\)"):
        chosen(["smcc"])
    with pytest.raises(SystemExit) as end:
        command_line.main(["--measure", "smcc"])
    assert end.value.code == 2
    assert "did you mean 'smc'" in capsys.readouterr().err
