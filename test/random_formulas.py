"""Random formulas with their text in this grammar and in that of rtamt, and the textbook definition of robustness."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

DRAWN = ("speed", "limit", "reference_speed")
RTAMT_WORDS = {"G": "always", "F": "eventually", "H": "historically", "O": "once", "U": "until", "S": "since"}


@dataclass(frozen=True)
class Node:
    """Operator, operands (nodes, names or numbers) and window in samples, None without one."""

    kind: str
    parts: tuple = ()
    window: tuple[int, int] | None = None


def random_formula(stream: np.random.Generator, depth: int, longest: int) -> Node:
    """Return a random formula; windows end at most after ``longest`` samples."""
    if depth == 0:
        return Node(str(stream.choice(["<=", ">=", "<", ">"])), (random_term(stream, 2), random_term(stream, 0)))
    kind = str(stream.choice(["not", "and", "or", "->", "G", "F", "H", "O", "U", "S"]))
    count = 1 if kind in ("not", "G", "F", "H", "O") else 2
    below = [random_formula(stream, int(stream.integers(0, depth)), longest) for _ in range(count)]
    window = None
    if kind in RTAMT_WORDS and stream.random() < 0.8:
        begin, end = sorted(int(limit) for limit in stream.integers(0, longest + 1, 2))
        window = (begin, end)
    return Node(kind, tuple(below), window)


def random_term(stream: np.random.Generator, depth: int) -> Node:
    kind = str(stream.choice(["signal", "number", "abs", "+", "-", "*"])) if depth else "signal"
    if kind == "signal":
        return Node("signal", (str(stream.choice(DRAWN)),))
    if kind == "number":
        return Node("number", (round(float(stream.normal()), 3),))
    if kind == "abs":
        return Node("abs", (random_term(stream, depth - 1),))
    if kind == "*":
        return Node("*", (Node("factor", (round(float(stream.uniform(0.1, 3.0)), 3),)), random_term(stream, depth - 1)))
    return Node(kind, (random_term(stream, depth - 1), random_term(stream, depth - 1)))


def text_of(node: Node, rtamt: bool = False) -> str:
    """Return the text of a node; a sample lasts 1 s for rtamt and 0.1 s here."""
    parts = [text_of(part, rtamt) for part in node.parts if isinstance(part, Node)]
    if node.kind in ("signal", "factor"):
        return str(node.parts[0])
    if node.kind == "number":
        return f"({node.parts[0]})" if rtamt else f"({node.parts[0]} m/s)"
    if node.kind in ("abs", "not"):
        return f"{node.kind}({parts[0]})"
    window = ""
    if node.window is not None:
        begin, end = node.window
        window = f"[{begin}:{end}]" if rtamt else f"[{begin / 10}, {end / 10}]"
    word = RTAMT_WORDS[node.kind] if rtamt and node.kind in RTAMT_WORDS else node.kind
    if len(parts) == 1:
        return f"{word}{window}({parts[0]})"
    return f"({parts[0]}) {word}{window} ({parts[1]})"


def textbook(node: Node, signals: dict[str, np.ndarray], at: int) -> float:
    """Return the robustness at one sample by the definition, without sharing of intermediate results."""
    size = len(signals["speed"])
    kind = node.kind
    if kind in ("<=", "<"):
        return term(node.parts[1], signals, at) - term(node.parts[0], signals, at)
    if kind in (">=", ">"):
        return term(node.parts[0], signals, at) - term(node.parts[1], signals, at)
    if kind == "not":
        return -textbook(node.parts[0], signals, at)
    if kind in ("and", "or", "->"):
        left, right = (textbook(part, signals, at) for part in node.parts)
        return min(left, right) if kind == "and" else max(left, right) if kind == "or" else max(-left, right)
    begin, end = node.window or (0, size)
    sign = -1 if kind in ("H", "O", "S") else 1
    places = [at + sign * step for step in range(begin, end + 1) if 0 <= at + sign * step < size]
    if kind in ("G", "H"):
        return min((textbook(node.parts[0], signals, place) for place in places), default=math.inf)
    if kind in ("F", "O"):
        return max((textbook(node.parts[0], signals, place) for place in places), default=-math.inf)
    found = -math.inf
    for place in places:
        before = [textbook(node.parts[0], signals, other) for other in range(at, place, sign)]
        found = max(found, min([textbook(node.parts[1], signals, place), *before]))
    return found


def term(node: Node, signals: dict[str, np.ndarray], at: int) -> float:
    if node.kind == "signal":
        return float(signals[node.parts[0]][at])
    if node.kind in ("number", "factor"):
        return float(node.parts[0])
    values = [term(part, signals, at) for part in node.parts]
    if node.kind == "abs":
        return abs(values[0])
    if node.kind == "*":
        return values[0] * values[1]
    return values[0] + values[1] if node.kind == "+" else values[0] - values[1]


def with_rtamt(node: Node, signals: dict[str, np.ndarray]) -> np.ndarray:
    """Return the robustness at every sample from the discrete-time evaluator of rtamt."""
    import rtamt

    spec = rtamt.StlDiscreteTimeSpecification()
    for name in DRAWN:
        spec.declare_var(name, "float")
    spec.spec = text_of(node, rtamt=True)
    spec.parse()
    size = len(signals["speed"])
    rows = spec.evaluate({"time": list(range(size)), **{name: list(signals[name]) for name in DRAWN}})
    return np.array([value for _, value in rows])
