"""README, pages and site: every block runs, every link leads, no network; ``train-ato docs`` opens it."""

import json
import re
from pathlib import Path
from xml.etree import ElementTree

import pytest
from commands import answer, complaint
from waiting import reserved_domain

from msgs_docs.generate import gallery_page, reference_pages, site, tutorials
from msgs_docs.generate.reference_pages import MODELS, schema_text
from msgs_docs.generate.rows import read_rows
from msgs_docs.generate.tutorials import Block, executed, page_blocks, run_block
from plant_sim.library import consist_names, line_names
from train_ato.cli import main, new
from train_ato.cli.main import COMMANDS
from train_ato.program.version import VERSION
from train_ato.scenario.scenario import expectation_of
from train_ato.scenario.scenario_files import scenario_names

ROOT = Path(__file__).resolve().parents[1]


TUTORIALS = sorted((ROOT / "msgs_docs" / "tutorials").glob("*.md"))


@pytest.mark.graph
@pytest.mark.timeout(900)
def test_the_site_is_built_without_a_warning_and_needs_no_network(tmp_path, capfd, monkeypatch):
    """Breaks if a link is dead, a page is in no table of contents, or a page loads a file of another host."""
    monkeypatch.setattr(tutorials, "write_tutorials", lambda folder: None)  # each is a case of its own below
    assert site.build(ROOT, tmp_path / "site") == 0, capfd.readouterr().err
    pages = {str(page.relative_to(tmp_path / "site")): page.read_text() for page in (tmp_path / "site").rglob("*.html")}
    for path in [ROOT / name for name in site.DOCUMENTS] + sorted((ROOT / "msgs_docs").rglob("*.md")):
        assert str(path.relative_to(ROOT).with_suffix(".html")) in pages
    for name, text in pages.items():
        assert not re.search(r"<(script|img|iframe)[^>]* src=\"(https?:)?//|<link[^>]* href=\"(https?:)?//", text), name
    index = (tmp_path / "site" / "searchindex.js").read_text()
    for made in ("reference/keys_scenario", "how_to/tune_by_symptom", "concepts/loop", "gallery/gallery"):
        assert f"msgs_docs/{made}" in index
    gallery = pages["msgs_docs/gallery/gallery.html"]
    runs = len(gallery_page.gallery(ROOT))
    assert gallery.count("<strong>passed (") == gallery.count('<img alt="run of ') == runs > 6
    assert "msgs_docs/reference/keys_scenario" in index and "holding_brake_ratio" in index
    assert sum(path.stat().st_size for path in (tmp_path / "site").rglob("*") if path.is_file()) < 15e6


@pytest.mark.campaign
@pytest.mark.parametrize("page", TUTORIALS, ids=lambda page: page.stem)
def test_a_tutorial_runs_to_a_passed_verdict(page, tmp_path):
    """Breaks if a command of a tutorial is refused, or its last run does not pass its criteria."""
    text = tutorials.executed(page.read_text(encoding="utf-8"), tmp_path / page.stem)
    assert text.count("\n```text\n") > page.read_text(encoding="utf-8").count("\n```text\n")


def test_the_gallery_has_every_scenario_train_and_line(tmp_path):
    """Breaks if one is left out, a picture is not drawn, or a stored verdict is not the expected one."""
    pages = [gallery_page.scenarios_page(ROOT, tmp_path), gallery_page.trains_page(tmp_path)]
    pages.append(gallery_page.lines_page(tmp_path))
    names = (scenario_names(), consist_names(), line_names())
    for page, wanted in zip(pages, names, strict=True):
        assert re.findall(r"^## (.*)$", page, re.MULTILINE) == list(wanted)
        pictures = re.findall(r"!\[[^]]*\]\(([^)]*)\)", page)
        assert len(set(pictures)) == len(wanted)
        for picture in pictures:
            drawn = ElementTree.parse(tmp_path / picture).iter()
            lines = [line.get("d", "") for line in drawn if "stroke: " in line.get("style", "")]
            assert len(lines) > 1 and "nan" not in "".join(lines)
    for name, row in read_rows(ROOT / gallery_page.MEASURED).items():
        expected = expectation_of(name)
        assert expected is None or row["verdict"].startswith("passed") is (expected.verdict == "passed"), name
    assert sum(path.stat().st_size for path in tmp_path.iterdir()) < 2e6


def test_a_page_without_a_place_in_the_contents_is_missing_in_the_navigation():
    """Breaks if the navigation lists a page that the contents do not have: Sphinx would find no missing one."""
    text = site.with_navigation("README", "", ROOT)
    assert "/msgs_docs/guide\n" in text and "/msgs_docs/README\n" in text and ":caption: Evidence" in text
    assert site.with_navigation("msgs_docs/guide", "[a](plant.md)", ROOT) == "[a](plant.md)"
    assert "\npid\n" in site.with_navigation("msgs_docs/laws/README", "[pid](pid.md), [up](../guide.md)", ROOT)


@pytest.mark.parametrize("kind", MODELS)
def test_the_reference_has_every_key_with_its_block(kind):
    """Breaks if a block of keys is not reached from the top of its file, or a key has no row."""
    page = reference_pages.keys_page(kind)
    schema = json.loads(schema_text(kind))
    blocks = re.split(r"\n## (?=\w)", page)
    tables = {block.partition("\n")[0]: block for block in blocks[1:]} | {"": blocks[0]}
    wanted = {"": schema} | {name: part for name, part in schema.get("$defs", {}).items() if "properties" in part}
    assert set(wanted) <= set(tables)
    for name, part in wanted.items():
        missing = [key for key in part.get("properties", {}) if f"`{key}`" not in tables[name]]
        assert missing == [], name


def test_the_reference_has_every_command_and_message(tmp_path):
    """Breaks if a command has no section, an argument like NAME|FILE more cells, or a message loses its words."""
    page = reference_pages.commands_page()
    assert re.findall(r"^## (.*)$", page, re.MULTILINE) == [name for name, _ in COMMANDS]
    assert "| `--engine` | plain Python loop without ROS" in page and "| `NAME \\| FILE` | " in page
    rows = [line for line in page.splitlines() if line.startswith("|")]
    assert [row for row in rows if len(re.split(r"(?<!\\)\|", row)) != 4] == []
    for folder in ("plant_sim", "train_ato"):
        (tmp_path / folder).mkdir()
    (tmp_path / "train_ato" / "one.py").write_text(
        'def f(a):\n    raise ValueError(f"speed {a:g}: out of range" f"; give {a}")\n'
    )
    assert "## train_ato/one.py\n\n* speed ...: out of range; give ...\n" in reference_pages.errors_page(tmp_path)


def test_docs_prints_the_entrance_or_how_to_build_it(tmp_path, monkeypatch, capsys):
    """Breaks if the command needs a browser, or does not say how a missing site is built."""
    monkeypatch.setattr(new, "__file__", str(tmp_path / "train_ato" / "cli" / "new.py"))
    monkeypatch.setattr("importlib.metadata.files", lambda name: [])
    assert "python -m msgs_docs.generate --site" in complaint(capsys, "docs")
    page = tmp_path / "site" / "index.html"
    page.parent.mkdir()
    page.write_text("site")
    assert answer(capsys, "docs") == {"page": str(page)}
    opened = []
    monkeypatch.setattr("webbrowser.open", lambda address: opened.append(address))
    assert main(["docs"]) == 0
    told = capsys.readouterr()
    assert told.out == f"{page}\n" and "no browser" in told.err and opened == [page.as_uri()]


@pytest.mark.parametrize("symptom", site.SYMPTOMS, ids=lambda symptom: symptom["symptom"][:40])
def test_the_change_of_a_symptom_removes_it(symptom):
    """Breaks if the page of the symptoms has a cause without effect, or a change that leaves half of it."""
    before, after = site.both_drives(symptom)
    assert after < 0.5 * before


def test_the_commands_of_a_citation_are_right(tmp_path, monkeypatch, capsys):
    """Breaks if a run has no version or resolved scenario to cite, or is not verified."""
    text = (ROOT / "msgs_docs" / "cite.md").read_text()
    commands = [line.split("#")[0].split() for line in text.splitlines() if line.startswith("    ")]
    monkeypatch.chdir(tmp_path)
    for name, *words in commands:
        if name == "train-ato":
            assert main(words) == 0, words
        else:
            assert (tmp_path / words[-1]).is_file()
    assert json.loads((tmp_path / "cited" / "summary.json").read_text())["version"] == VERSION
    assert "equal" in capsys.readouterr().out


def test_the_paper_is_short_and_its_references_exist():
    """Breaks if the paper exceeds 1 000 words or cites an entry that its bibliography lacks."""
    text = (ROOT / "paper" / "paper.md").read_text().partition("# Summary")[2]
    entries = set(re.findall(r"^@\w+\{(\w+),", (ROOT / "paper" / "paper.bib").read_text(), re.MULTILINE))
    assert len(text.split()) <= 1000
    assert set(re.findall(r"\[@(\w+)\]", text)) == entries


def test_the_page_of_the_loop_has_every_link_and_every_key_with_its_default():
    """Breaks if a link gets a name that the picture lacks, or a key of the page is renamed."""
    schema = json.loads(schema_text("scenario"))
    keys = [key for part in site.PARTS.values() for key in part]
    links = {key.split(".")[1] for key in keys if key.startswith("links.")}
    assert links == set(schema["$defs"]["Links"]["properties"])
    page = site.loop_page()
    assert all(f"| `{key}` | " in page for key in keys)
    assert "| `supervision.period` | " in page and "| `0.4` |" in page
    with pytest.raises(KeyError):
        site.key_of(schema, "links.command.dely")


TEXT = (ROOT / "README.md").read_text(encoding="utf-8")
FIRST = "train-ato run demo"
"""Command of the installation, which makes the environment of the tests, and of the section after it."""
PAGES = sorted({ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "msgs_docs").rglob("*.md")})


@pytest.mark.graph
@pytest.mark.timeout(900)
def test_every_block_runs_to_a_passed_verdict(tmp_path: Path) -> None:
    """Breaks if a command of README is refused, a call of Python fails, or a run does not pass its criteria."""
    domain = reserved_domain()  # `train-ato param` without a domain needs a single run on the machine
    assert f" && .venv/bin/{FIRST}\n" in TEXT
    found = [Block("sh", FIRST, "", 0), *page_blocks(TEXT[TEXT.index("## First run") :])]
    assert {"sh", "python"} <= {block.language for block in found}
    for block in found:
        run_block(block, tmp_path, domain)
    logs = tmp_path.rglob("run.mcap")
    runs = [json.loads((log.parent / "summary.json").read_text(encoding="utf-8")) for log in logs]
    assert len(runs) >= 4
    assert [(run["scenario"], run["verdict"]) for run in runs if run["verdict"] != "passed"] == []
    assert any(change["value"] == "smc" for run in runs for change in run["changes"])


def test_a_tutorial_shows_what_its_blocks_print_and_draw(tmp_path: Path) -> None:
    """Breaks if a block is left out, a picture is lost, or a tutorial with a failed command or verdict is built."""
    page = (
        "# A\n\n```python one.py\nNAME = 'passed'\n```\n\n    echo shown > a.png\n\n"
        "```python\nfrom one import NAME\nprint(NAME, 'in the end')\n```\nB\n\n```text\nfailed\n```\n"
    )
    text = executed(page, tmp_path / "a_page")
    assert text == page.replace("a.png\n", "a.png\n\n![a.png](a_page_a.png)\n").replace(
        "end')\n```\n", "end')\n```\n\n```text\npassed in the end\n```\n"
    )
    assert (tmp_path / "a_page_a.png").read_text() == "shown\n"
    for change, told in (("'failed'", "not passed"), ("1 / 0", "ZeroDivisionError"), ("'-'", "not passed")):
        with pytest.raises(ValueError, match=told):
            executed(page.replace("'passed'", change), tmp_path / "a_page")


JUDGED = [ROOT / "README.md", *(ROOT / "msgs_docs" / "laws").glob("*.md"), *(
    ROOT / "msgs_docs" / f"{name}.md" for name in ("any_law", "learning", "mpc_goals", "mpc_table", "two_locomotives")
)]  # fmt: skip
"""Pages whose figures of runs have the outcome of tracking beside them."""


def test_every_table_of_runs_has_their_outcome() -> None:
    """Breaks if a table has the figures of a limit cycle without a word about it."""
    figures = re.compile(r"\brms\b|km/h|\bm/s\b(?!²)|kN/s")
    heads = {
        head
        for page in JUDGED
        for head in re.findall(r"^(\|.*\|)\n\|---", page.read_text(encoding="utf-8"), re.MULTILINE)
        if figures.search(head) and not re.search(r"outcome|\btracked\b|unit", head)
    }
    linear = "| delay s | disturbance | jerk m/s³ | rms m | kN/s | of the mean | couplers kN | after 25 s |"
    assert heads == {linear}, "the table of a linear train has no run"


def test_readme_fits_on_two_screens() -> None:
    """Breaks if the entrance grows to a wall again: at most 120 lines and 9 kB, a picture at once, a whole law."""
    assert len(TEXT.splitlines()) <= 120 and len(TEXT.encode()) <= 9_000
    assert "![" in "\n".join(TEXT.splitlines()[:6])
    assert [block.file for block in page_blocks(TEXT) if "class MyLaw(GuardedLaw):" in block.text] == ["my_law.py"]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_link_leads_somewhere(page: Path) -> None:
    """Breaks if a page or a heading is renamed and a link still has the old name."""
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        if re.match(r"[a-z]+:", target):
            continue
        name, _, anchor = target.partition("#")
        file = (page.parent / name).resolve() if name else page
        assert file.exists(), f"{page.name}: {target}"
        if anchor and file.suffix == ".md":
            headings = re.findall(r"^#+ (.*)$", file.read_text(encoding="utf-8"), re.MULTILINE)
            anchors = {re.sub(r"[^\w\- ]", "", heading.strip().lower()).replace(" ", "-") for heading in headings}
            assert anchor in anchors, f"{page.name}: {target}"
