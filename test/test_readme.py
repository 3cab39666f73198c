"""README: every block of commands and of Python runs, in order, in an empty folder; every link of the pages leads."""

import json
import re
from pathlib import Path

import pytest
from waiting import reserved_domain

from msgs_docs.generate.tutorials import Block, executed, page_blocks, run_block

ROOT = Path(__file__).resolve().parents[1]
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
