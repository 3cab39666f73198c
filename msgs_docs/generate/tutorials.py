"""Run the blocks of a tutorial in order in an empty folder; write what each prints and draws below it.

A page is Markdown. A block ``sh`` is a script of bash with the installed commands, a block ``python`` a program, and a
block with a second word, as ``yaml line.yaml``, is the content of that file. Every other block is text.
"""

import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

FENCED = r"^```(?P<language>\w+)(?: (?P<file>[\w./-]+))?\n(?P<body>(?s:.*?))^```\n"
INDENTED = r"(?P<indented>(?:^ {4}\S.*\n)+)"
BLOCK = re.compile(f"{FENCED}|{INDENTED}", re.MULTILINE)
VERDICT = re.compile(r"^(?:passed|failed|no criteria|aborted)\b.*", re.MULTILINE)
"""First words of a line with the verdict of a run."""
TIME_LIMIT = 600.0
"""Largest duration of a block [s]."""


@dataclass(frozen=True)
class Block:
    """Block of a page.

    Attributes
    ----------
    language
        ``sh``, ``python``, or another language, which is not run.
    text
        Content.
    file
        File that the block is the content of; empty: none.
    end
        Place after the block in the page.
    """

    language: str
    text: str
    file: str
    end: int


def page_blocks(page: str) -> Iterator[Block]:
    """Yield the blocks of a page in order; indented lines are ``sh``."""
    for match in BLOCK.finditer(page):
        if match["indented"]:
            yield Block("sh", match["indented"], "", match.end())
        else:
            yield Block(match["language"], match["body"], match["file"] or "", match.end())


def run_block(block: Block, folder: Path, domain: int) -> str:
    """Write the file of a block, or run it in a folder; return its standard output.

    Raises
    ------
    ValueError
        If a command fails: the block with the end of its output.
    """
    if block.file:
        (folder / block.file).write_text(block.text, encoding="utf-8")
        return ""
    if block.language not in ("sh", "python"):
        return ""
    order = ["bash", "-euc", block.text] if block.language == "sh" else [sys.executable, "-c", block.text]
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    environment = {**os.environ, "PATH": path, "ROS_DOMAIN_ID": str(domain), "MPLBACKEND": "Agg", "COLUMNS": "110"}
    done = subprocess.run(
        order, cwd=folder, env=environment, capture_output=True, text=True, check=False, timeout=TIME_LIMIT
    )
    if done.returncode:
        raise ValueError(f"{block.text}\nexit status {done.returncode}\n{done.stdout[-2000:]}\n{done.stderr[-2000:]}")
    return done.stdout


def executed(page: str, pictures: Path) -> str:
    """Run a tutorial; return its page with output and pictures below each block.

    Parameters
    ----------
    page
        Text of the page.
    pictures
        Folder of the page, to which the pictures are copied that a block names.

    Raises
    ------
    ValueError
        If a block fails, or the last verdict that the page prints is not passed.
    """
    from train_ato.ros.graph.domain_lock import DomainLock
    from train_ato.ros.graph.environment import DOMAINS, VALID

    # `train-ato param` without a domain needs a single run on the machine, and no other run takes one beyond DOMAINS
    domain = next(number for number in VALID if number not in DOMAINS and not DomainLock(number).held)
    text, done, printed = "", 0, ""
    with tempfile.TemporaryDirectory(prefix="train_ato_tutorial_") as scratch:
        folder = Path(scratch)
        for block in page_blocks(page):
            output = run_block(block, folder, domain)
            printed += output
            text += page[done : block.end] + (f"\n```text\n{output.rstrip()}\n```\n" if output.strip() else "")
            done = block.end
            for name in dict.fromkeys(re.findall(r"(?<!/)\b[\w-]+\.png\b", block.text)):
                if (folder / name).is_file():
                    copy = f"{pictures.name}_{name}"
                    shutil.copy(folder / name, pictures.parent / copy)
                    text += f"\n![{name}]({copy})\n"
    verdicts = VERDICT.findall(printed)
    if not verdicts or not verdicts[-1].startswith("passed"):
        raise ValueError(f"the last verdict of the tutorial is {verdicts[-1:]}, which is not passed")
    return text + page[done:]


def write_tutorials(folder: Path) -> None:
    """Run every tutorial of a folder in place.

    Raises
    ------
    ValueError
        If one fails, with its page.
    """
    for path in sorted(folder.glob("*.md")):
        try:
            path.write_text(executed(path.read_text(encoding="utf-8"), path.with_suffix("")), encoding="utf-8")
        except ValueError as error:
            raise ValueError(f"{path.name}: {error}") from None
