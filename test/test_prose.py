"""Plain English: the number of sentences that break the rules of CONTRIBUTING.md may only fall.

Rules, by pattern: (a) the first line of a docstring begins with a verb or a noun, not with What, Who, Whether, Where or
How, and has no "whether"; (b) software and physics are the subjects of a sentence, not persons; a noun instead of "what
is" or "who has"; (c) "is" instead of "stands".  The rules apply to docstrings, messages, comments, YAML texts and
Markdown pages.
"""

import ast
import io
import os
import re
import tokenize
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
FIRST_WORD = re.compile(r"(What|Who|Whether|Where|How)\b")
IN_FIRST_LINE = re.compile(r"\bwhether\b")
SENTENCE = re.compile(
    r"\b(tells?|told|believes?|asks?|asked|knows?|stands?|somebody|nobody|anybody)\b"
    r"|\b(what|who) (is|are|was|has|it|they|no)\b",
    re.IGNORECASE,
)
ANY_WORD = re.compile(
    r"[\"']\s*(What|Who|Whether|Where|How)\b|\bwhether\b"
    r"|(?<!\.)\b(?i:tells?|told|believes?|asks?|asked|knows?|stands?|somebody|nobody|anybody)\b(?!\()"
    r"|\b(?i:(what|who)\W+(f[\"']\W*)?(is|are|was|has|it|they|no))\b"
)
"""Words of every pattern, not as names of calls: a file without them has no text to be taken apart."""
CODE = re.compile(r"``.*?``|`[^`\n]*`|https?://\S+", re.DOTALL)
FENCE = re.compile(r"^(```|~~~).*?^\1|^(?: {4}|\t).*?$", re.DOTALL | re.MULTILINE)
COMMENT = re.compile(rf"#[^\n]*(?:{SENTENCE.pattern})", re.IGNORECASE)
"""Comment, or sign in a text, before words of the pattern."""
NO_SOURCES = ("build", "dist", "install", "log", "runs")
TEXT_KEYWORDS = {"help", "description", "epilog"}
TEXT_CALLS = {"write", "add", "add_option"}

COUNTS: dict[str, int] = {
    "bench": 0, "examples": 0, "msgs_docs": 0, "pages": 0, "plant_sim": 0, "test": 0, "train_ato": 0,
    "train_ato/api": 0, "train_ato/cli": 0, "train_ato/control": 0, "train_ato/judge": 0, "train_ato/log": 0,
    "train_ato/loop": 0, "train_ato/messages": 0, "train_ato/papers": 0, "train_ato/profile": 0,
    "train_ato/program": 0, "train_ato/playback": 0, "train_ato/report": 0, "train_ato/ros": 0, "train_ato/scenario": 0,
    "train_ato/studies": 0, "train_ato/supervision": 0, "train_ato/view": 0,
}  # fmt: skip
"""Sentences that break the rules, by room.  A number may only fall; after an improvement lower it here."""


def room_of(path: Path) -> str:
    """Return the room of a file: a folder of ``train_ato``, another folder of the first level, or ``pages``."""
    parts = path.relative_to(ROOT).parts
    if len(parts) == 1:
        return "pages"
    return "/".join(parts[:2]) if parts[0] == "train_ato" and len(parts) > 2 else parts[0]


def files() -> Iterator[Path]:
    """Yield the source files, pages and shipped YAML files."""
    for folder, below, names in os.walk(ROOT):
        left_out = NO_SOURCES if folder == str(ROOT) else ()
        below[:] = sorted(name for name in below if not name.startswith(".") and name not in left_out)
        yield from (Path(folder, name) for name in sorted(names) if name.endswith((".py", ".md", ".yaml")))


def text_of(node: ast.expr) -> str:
    """Return the constant text of a string expression; formatted values become ``x``."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return node.value
    if isinstance(node, ast.JoinedStr):
        return "".join(text_of(part) if isinstance(part, ast.Constant) else "x" for part in node.values)
    if isinstance(node, ast.BinOp):
        return f"{text_of(node.left)} {text_of(node.right)}"
    return ""


def python_texts(source: str) -> Iterator[tuple[int, bool, str]]:
    """Yield line, True for a docstring, and text of docstrings, messages and comments."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            yield node.lineno, True, node.value.value
        elif isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call):
            for argument in node.exc.args:
                yield node.lineno, False, text_of(argument)
        elif isinstance(node, ast.Call):
            if getattr(node.func, "attr", getattr(node.func, "id", "")) in TEXT_CALLS:
                yield from ((node.lineno, False, text_of(argument)) for argument in node.args)
            for keyword in node.keywords:
                if keyword.arg in TEXT_KEYWORDS:
                    yield node.lineno, False, text_of(keyword.value)
    commented = COMMENT.search(source) is not None
    for token in tokenize.generate_tokens(io.StringIO(source).readline) if commented else ():
        if token.type == tokenize.COMMENT:
            yield token.start[0], False, token.string


def faults(path: Path) -> Iterator[tuple[int, str]]:
    """Yield line and words of every sentence that breaks a rule."""
    source = path.read_text(encoding="utf-8")
    if ANY_WORD.search(source) is None:
        return
    if path.suffix == ".py":
        texts = python_texts(source)
    else:
        texts = iter([(1, False, FENCE.sub("", source) if path.suffix == ".md" else source)])
    for line, docstring, text in texts:
        plain = CODE.sub("x", text)
        if docstring and (
            first := FIRST_WORD.match(plain.strip()) or IN_FIRST_LINE.search(plain.strip().split("\n")[0])
        ):
            yield line, first.group()
        for found in SENTENCE.finditer(plain):
            yield line + plain.count("\n", 0, found.start()), found.group()


def test_sentences_against_the_rules_only_become_fewer() -> None:
    """Breaks if a new sentence breaks a rule, or if the number of a room was not lowered after an improvement."""
    found = Counter(dict.fromkeys(COUNTS, 0))
    places = []
    for path in files():
        for line, words in faults(path) if path != Path(__file__).resolve() else ():
            found[room_of(path)] += 1
            places.append(f"{path.relative_to(ROOT)}:{line}: {words}")
    assert {room: count for room, count in found.items() if count > COUNTS.get(room, 0)} == {}, "\n".join(places)
    assert found == COUNTS, "lower COUNTS to the found ones"


GLOSSARY = re.findall(
    r"^\| ([^|]+) \| ([^|]+) \| ([^|]+) \| `(.+)`: `(.+)` \|$", (ROOT / "msgs_docs" / "glossary.md").read_text(), re.M
)


def test_glossary_terms_are_unique_and_in_the_code() -> None:
    terms = [row[0] for row in GLOSSARY]
    assert len(terms) == len(set(terms)) >= 60
    missing = [
        f"{term}: {file}: {name}"
        for term, _, _, file, name in GLOSSARY
        if not (ROOT / file).is_file() or not re.search(rf"\b{re.escape(name)}\b", (ROOT / file).read_text())
    ]
    assert missing == []


def test_the_patterns_find_the_faults_they_name(tmp_path: Path) -> None:
    """Breaks if a pattern, a kind of text or the removal of code is lost."""
    path = tmp_path / "sample.py"
    path.write_text(
        '"""What a run needs."""\n'
        "def f(x):\n"
        '    """Return whether it is."""\n'
        "    # the law knows it\n"
        '    raise ValueError(f"{x}: nobody {x} told; it stands")\n'
        'help(help="Who is `asked`", name="asked")\n'
        'file.write(f"{x} asks")\n'
        'add("--out FILE", "file told")\n'
    )
    assert [(line, words) for line, words in sorted(faults(path))] == [
        (1, "What"), (3, "whether"), (4, "knows"), (5, "nobody"), (5, "stands"), (5, "told"), (6, "Who is"),
        (7, "asks"), (8, "told"),
    ]  # fmt: skip
    page = tmp_path / "page.md"
    page.write_text("The node tells `what is` next.\n\n```\nask who is\n```\n\n    told\n\nNobody asks.\n")
    assert [words for _, words in faults(page)] == ["tells", "Nobody", "asks"]
