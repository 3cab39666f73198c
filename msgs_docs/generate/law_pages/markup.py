"""Conversion of a docstring of this project to Markdown."""

from __future__ import annotations

import re
from collections.abc import Mapping

NEEDS = "Needs: "


def sections(text: str, pages: Mapping[str, str]) -> tuple[str, str, str, str]:
    """Split a component's docstring.

    Parameters
    ----------
    text
        The docstring, cleaned: a title, what the component does, the law itself, ``Needs: ...``.
    pages
        Module to page, for links.

    Returns
    -------
    title, does, law, needs : str
        Markdown; ``law`` and ``needs`` may be empty.
    """
    paragraphs = re.split(r"\n\n+(?! )", text.strip())
    title, rest = " ".join(paragraphs[0].split()), paragraphs[1:]
    needs = [part for part in rest if part.startswith(NEEDS)]
    body = [part for part in rest if not part.startswith(NEEDS)]
    needed = needs[0].removeprefix(NEEDS) if needs else ""
    does, law = (body[0], body[1:]) if body else ("", [])
    return (
        inline(title, pages),
        markdown(does, pages),
        "\n\n".join(markdown(part, pages) for part in law),
        markdown(needed[:1].upper() + needed[1:], pages),
    )


def markdown(paragraph: str, pages: Mapping[str, str]) -> str:
    """Return a paragraph in Markdown; an indented block after it becomes code."""
    lines, result, code = paragraph.splitlines(), [], False
    for line in lines:
        indented = line.startswith("    ") or (code and not line.strip())
        if indented and not code:
            result += ["", "```text"]
        elif code and not indented:
            result += ["```", ""]
        code = indented
        result.append(line.removeprefix("    ") if indented else inline(line, pages))
    if code:
        result.append("```")
    return re.sub(r"\n{3,}", "\n\n", "\n".join(result)).strip()


def inline(line: str, pages: Mapping[str, str]) -> str:
    """Return one line of text: code, links to other pages, no accidental emphasis."""
    line = re.sub(r":mod:`([\w.]+)`", lambda found: _link(found.group(1), pages), line)
    line = re.sub(r":\w+:`~?([\w.]+)`", r"`\1`", line)
    line = re.sub(r"``(.+?)``", r"`\1`", line)
    line = re.sub(r"(?<=\w)\*(?=[\w_])", r"\\*", line)
    return re.sub(r"::$", ":", line)


def _link(module: str, pages: Mapping[str, str]) -> str:
    page = pages.get(module)
    return f"`{module}`" if page is None else f"[`{module.rpartition('.')[2]}`]({page}.md)"
