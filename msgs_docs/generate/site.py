"""The site: pages of the repository, the reference, and pages made of runs, built offline by Sphinx into ``site/``.

The navigation is made from the tables of ``msgs_docs/README.md``: a page without a link there is a warning of Sphinx,
and a warning is an error.
"""

import json
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import train_ato as ta
from msgs_docs.generate.reference_pages import as_cell, as_code, as_table, schema_text
from msgs_docs.generate.rows import page_text, table_lines, texts
from plant_sim.units import number_text
from train_ato.judge.metric_names import METRICS

DRIVE: dict[str, Any] = texts("site")["drive"]
"""Short drive of the metro train from rest to rest."""
SYMPTOMS: list[dict[str, Any]] = texts("site")["symptoms"]
"""Rows of the page: symptom, keys of its cause and of the change, remedy, metric; another scenario or drive."""


def both_drives(symptom: Mapping[str, Any]) -> tuple[float, float]:
    """Return the magnitude of the metric with the cause, without and with the change."""
    changes = {**symptom.get("drive", DRIVE), **symptom["cause"]}
    start = ta.scenario(symptom.get("scenario", "xuzhou_metro")).with_(changes)
    runs = (ta.run(start), ta.run(start.with_(symptom["change"])))
    values = [run.metrics[symptom["metric"]] for run in runs]
    return abs(values[0]), abs(values[1])


def symptom_page() -> str:
    """Return the page of the symptoms, with the metric of each before and after the change."""
    rows = []
    for symptom in SYMPTOMS:
        name, unit = METRICS[symptom["metric"]]
        cause = ", ".join(f"`{key}={value}`" for key, value in symptom["cause"].items()) or "none"
        shown = {key: _short(value) for key, value in symptom["change"].items() if key != "plant.start"}
        change = ", ".join(f"`{key}={value}`" for key, value in shown.items())
        figures = (number_text(value, 3) for value in both_drives(symptom))
        rows.append((symptom["symptom"], cause, symptom["remedy"], change, f"{name} in {unit}", *figures))
    heads = ("symptom", "cause in this drive", "change", "keys of the change", "metric", "before", "after")
    return page_text("symptoms", table=table_lines(heads, rows))


def _short(value: object) -> str:
    """Return a value in the words of YAML."""
    return re.sub(r"['{}\[\]]", "", str(value))


PARTS: dict[str, list[str]] = texts("site")["parts"]
"""Keys of a scenario by part of the loop."""


def loop_page() -> str:
    """Return the page of the loop."""
    schema = json.loads(schema_text("scenario"))
    rows = []
    for part, keys in PARTS.items():
        for key in keys:
            value = key_of(schema, key)
            default = as_code(value["default"]) if "default" in value else ""
            rows.append((part, f"`{key}`", as_cell(value.get("description", "")), default))
    return page_text("loop", keys=as_table(("part", "key", "meaning", "default"), rows))


def key_of(schema: dict[str, Any], path: str) -> dict[str, Any]:
    """Return the schema of the key of a scenario at a dotted path.

    Raises
    ------
    KeyError
        If a scenario has no such key.
    """
    block: dict[str, Any] = schema
    for name in path.split("."):
        for part in (block, *block.get("anyOf", ())):
            if "$ref" in part:
                block = schema["$defs"][part["$ref"].rpartition("/")[2]]
        block = block["properties"][name]
    return block


DOCUMENTS = (
    "README.md", "CONTRIBUTING.md", "CHANGELOG.md", "SECURITY.md", "CODE_OF_CONDUCT.md", "studies_done/README.md",
)  # fmt: skip
"""Pages of the top folder; the first one is the entrance."""
CONTENTS = Path("msgs_docs", "README.md")
MADE = {"How to": "how_to", "Concepts": "concepts", "Reference": "reference", "Gallery": "gallery"}
"""Folder below that of the contents with the pages that exist in the site only, by section."""
SITE = "site"
ENTRANCE = '<!doctype html><meta charset="utf-8"><meta http-equiv="refresh" content="0; url=README.html">\n'


def with_navigation(page: str, text: str, top: str | Path) -> str:
    """Return the text of a page with the pages below it, as hidden tables of contents.

    Parameters
    ----------
    page
        Path of the page from the top folder, without its suffix.
    text
        Text of the page.
    top
        Top folder of the repository.
    """
    if page == "README":
        contents = (Path(top) / CONTENTS).read_text(encoding="utf-8")
        trees = [_tree("Start", ["msgs_docs/README"])]
        for section in contents.split("\n## ")[1:]:
            heading, _, body = section.partition("\n")
            trees.append(_tree(heading, [f"msgs_docs/{link}" for link in _links(body)] + _made(top, heading)))
        trees.append(_tree("Gallery", _made(top, "Gallery")))
        return "".join([text, *trees, _tree("Project", [name.removesuffix(".md") for name in DOCUMENTS[1:]])])
    if page.endswith("/README") and Path(page).parent != CONTENTS.parent:
        return text + _tree("", _links(text))
    return text


def _made(top: str | Path, section: str) -> list[str]:
    """Return the pages of a section that exist in the site only."""
    folder = Path(top) / CONTENTS.parent / MADE.get(section, "none")
    return sorted(f"{CONTENTS.parent}/{folder.name}/{path.stem}" for path in folder.glob("*.md"))


def _links(text: str) -> list[str]:
    """Return the pages that a text has links to in its own folder or below, once each, without suffix."""
    return list(dict.fromkeys(re.findall(r"\]\(([\w/]+)\.md\)", text)))


def _tree(caption: str, pages: list[str]) -> str:
    """Return a hidden table of contents; the pages have paths from the page or from the top folder."""
    options = [":hidden:", f":caption: {caption}"] if caption else [":hidden:"]
    absolute = [f"/{page}" if caption else page for page in pages]
    return "\n\n```{toctree}\n" + "\n".join([*options, "", *absolute]) + "\n```\n"


def build(top: Path, target: Path, builder: str = "html") -> int:
    """Build the site with warnings as errors; return the exit status.

    Sphinx reads a copy of the pages, in which the pages of the reference are written; files of code that a page has
    links to are beside it.

    Parameters
    ----------
    top
        Top folder of the repository.
    target
        Folder of the site; a former one is replaced.
    builder
        Builder of Sphinx; ``linkcheck`` checks every external link of the pages and needs a network.
    """
    from importlib.util import find_spec

    missing = [name for name in ("sphinx", "myst_parser", "numpydoc", "furo") if find_spec(name) is None]
    if missing:
        raise ValueError(f"--site: {', '.join(missing)} not installed; run pip install -e '.[docs]'")
    shutil.rmtree(target, ignore_errors=True)
    with tempfile.TemporaryDirectory(prefix="train_ato_site_") as scratch:
        source = Path(scratch, "source")
        _copy_pages(top, source)
        if builder == "html":
            _write_made_pages(top, source / CONTENTS.parent)
        command = [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", "-b", builder]
        command += ["-c", str(source / CONTENTS.parent), "-d", f"{scratch}/trees", str(source), str(target)]
        status = subprocess.run(command, check=False).returncode
    if status == 0 and builder == "html":
        (target / "index.html").write_text(ENTRANCE, encoding="utf-8")
    return status


def _copy_pages(top: Path, source: Path) -> None:
    """Copy the pages and link the other folders."""
    source.mkdir()
    shutil.copytree(top / CONTENTS.parent, source / CONTENTS.parent, ignore=shutil.ignore_patterns("__pycache__"))
    for name in DOCUMENTS:
        (source / name).parent.mkdir(exist_ok=True)
        shutil.copy(top / name, source / name)
    for path in top.iterdir():
        if not (source / path.name).exists() and not path.name.startswith(".") and path.name != SITE:
            (source / path.name).symlink_to(path)


def _write_made_pages(top: Path, made: Path) -> None:
    """Write the pages that exist in the site only, and run the tutorials."""
    from msgs_docs.generate import gallery_page, reference_pages, tutorials

    for folder in ("how_to", "concepts", "reference"):
        (made / folder).mkdir()
    for name, text in reference_pages.pages(top).items():
        (made / "reference" / f"{name}.md").write_text(text, encoding="utf-8")
    (made / "how_to" / "tune_by_symptom.md").write_text(symptom_page(), encoding="utf-8")
    (made / "concepts" / "loop.md").write_text(loop_page(), encoding="utf-8")
    gallery_page.write_gallery(top, made / "gallery")
    tutorials.write_tutorials(made / "tutorials")
