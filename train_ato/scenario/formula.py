"""Syntax tree of a requirement in signal temporal logic (STL); ``train_ato/judge/requirements.py`` has its meaning.

O. Maler and D. Nickovic, "Monitoring temporal properties of continuous signals", FORMATS 2004.

The parser works by operator precedence (Pratt), with units. From the weakest to the strongest binding::

    ->    or    and    U S    not G F H O    <= >= < >    + -    * /    - (sign)
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass

from plant_sim.input_error import close_match
from plant_sim.units import unit_symbols
from train_ato.scenario.signals import SIGNALS, find_signal

Exponents = tuple[int, int, int]
"""Exponents of metre, kilogram and second."""
NO_DIMENSION: Exponents = (0, 0, 0)
_BASE: dict[str, Exponents] = {
    "m": (1, 0, 0), "kg": (0, 1, 0), "s": (0, 0, 1), "N": (1, 1, -2), "W": (2, 1, -3), "Pa": (-1, 1, -2),
    "1": NO_DIMENSION,
}  # fmt: skip
_POWERS = {"²": 2, "³": 3}


def product(left: Exponents, right: Exponents, sign: int = 1) -> Exponents:
    """Return the dimension of a product, with ``sign`` -1 of a quotient."""
    return left[0] + sign * right[0], left[1] + sign * right[1], left[2] + sign * right[2]


def dimension_of(si: str) -> Exponents:
    """Return the dimension of an SI symbol, such as ``m/s²`` or ``N s/m``."""
    above, _, below = si.partition("/")
    found = NO_DIMENSION
    for sign, part in ((1, above), (-1, below)):
        for factor in part.split():
            for _ in range(_POWERS.get(factor[-1], 1)):
                found = product(found, _BASE[factor.rstrip("²³")], sign)
    return found


def _accepted_units() -> dict[str, tuple[Exponents, float]]:
    """Return dimension and divisor of the units that a number can have, with ``m/s2`` and ``m/s^2`` for ``m/s²``."""
    found = {symbol: (dimension_of(si), divisor) for symbol, (si, divisor) in unit_symbols().items() if symbol != "1"}
    for sign, power in _POWERS.items():
        for symbol in [symbol for symbol in found if sign in symbol]:
            found[symbol.replace(sign, str(power))] = found[symbol.replace(sign, f"^{power}")] = found[symbol]
    return found


UNITS: dict[str, tuple[Exponents, float]] = _accepted_units()
"""Dimension and divisor of every unit: the SI value is the number over the divisor."""
UNIT_PATTERN = re.compile("|".join(re.escape(unit) for unit in sorted(UNITS, key=len, reverse=True)))
"""Longest unit at a place of a text."""


def unit_text(dimension: Exponents) -> str:
    """Return the SI symbol of a dimension, "" without one."""
    if dimension == NO_DIMENSION:
        return ""
    named = (si for si, _ in unit_symbols().values() if dimension_of(si) == dimension)
    powers = zip(("m", "kg", "s"), dimension, strict=True)
    return next(named, " ".join(f"{base}^{power}" for base, power in powers if power))


@dataclass(frozen=True)
class NumberTerm:
    """Number [SI]; ``dimension`` is None for 0 without a unit, which is comparable with everything."""

    value: float
    dimension: Exponents | None = NO_DIMENSION


@dataclass(frozen=True)
class SignalTerm:
    """Signal of the run."""

    name: str
    dimension: Exponents


@dataclass(frozen=True)
class AbsTerm:
    """Magnitude of a term."""

    operand: Term
    dimension: Exponents | None


@dataclass(frozen=True)
class ArithmeticTerm:
    """Sum, difference, product or quotient of two terms; ``operator`` is one of ``+ - * /``."""

    operator: str
    left: Term
    right: Term
    dimension: Exponents | None


@dataclass(frozen=True)
class Predicate:
    """Comparison of two terms; ``operator`` is one of ``<= >=``, also for ``<`` and ``>``."""

    operator: str
    left: Term
    right: Term

    @property
    def dimension(self) -> Exponents:
        """Dimension of both sides."""
        return self.left.dimension or self.right.dimension or NO_DIMENSION


@dataclass(frozen=True)
class Negation:
    """Logical not."""

    operand: Formula


@dataclass(frozen=True)
class Connective:
    """``and``, ``or`` or ``->`` of two formulas."""

    operator: str
    left: Formula
    right: Formula


@dataclass(frozen=True)
class Window:
    """Interval of time relative to the present sample [s]; ``end`` is infinite up to the end of the run."""

    begin: float = 0.0
    end: float = math.inf


@dataclass(frozen=True)
class Temporal:
    """``G`` always, ``F`` eventually, ``H`` historically (G of the past) or ``O`` once (F of the past)."""

    operator: str
    window: Window
    operand: Formula


@dataclass(frozen=True)
class Until:
    """``U``: ``right`` becomes true in the window, ``left`` is true before; ``S`` (since): the same in the past."""

    operator: str
    window: Window
    left: Formula
    right: Formula


Term = NumberTerm | SignalTerm | AbsTerm | ArithmeticTerm
Formula = Predicate | Negation | Connective | Temporal | Until


def nodes_of(node: Term | Formula) -> Iterator[Term | Formula]:
    """Yield a node and all nodes below it."""
    yield node
    for name in ("operand", "left", "right"):
        below = getattr(node, name, None)
        if below is not None:
            yield from nodes_of(below)


def signals_of(formula: Formula) -> tuple[str, ...]:
    """Return the names of the signals of a formula in order of their first use."""
    return tuple(dict.fromkeys(node.name for node in nodes_of(formula) if isinstance(node, SignalTerm)))


def robustness_dimension(formula: Formula) -> Exponents | None:
    """Return the dimension of the robustness; None for predicates of several dimensions."""
    found = {node.dimension for node in nodes_of(formula) if isinstance(node, Predicate)}
    return found.pop() if len(found) == 1 else None


MAX_LENGTH, MAX_DEPTH = 2000, 50
"""Largest number of characters and of nested operators of a formula."""
_WORDS = {
    "always": "G", "eventually": "F", "until": "U", "historically": "H", "once": "O", "since": "S", "implies": "->",
    "&": "and", "&&": "and", "|": "or", "||": "or", "!": "not", "=>": "->", "≤": "<=", "≥": ">=", "−": "-",
}  # fmt: skip
"""Other spellings."""
_BINARY: dict[str, int] = {
    "->": 1, "or": 2, "and": 3, "U": 4, "S": 4, "<=": 6, ">=": 6, "<": 6, ">": 6, "+": 7, "-": 7, "*": 8, "/": 8,
}  # fmt: skip
_UNARY, _SIGN = 5, 9
_TEMPORAL = ("G", "F", "H", "O")
_SPACE = re.compile(r"\s*")
_NUMBER = re.compile(r"(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")
_NAME = re.compile(r"[^\W\d]\w*")
_SIGNS = re.compile(r"->|=>|<=|>=|==|!=|&&|\|\||[-+*/<>()\[\],:&|!=≤≥−]")


@dataclass(frozen=True)
class _Token:
    """Part of the text: ``number``, ``name``, ``sign`` or ``end``; ``column`` counts from 1."""

    kind: str
    text: str
    column: int
    value: float = 0.0
    dimension: Exponents | None = NO_DIMENSION


def parse_formula(text: str) -> Formula:
    """Return the syntax tree of a requirement.

    Parameters
    ----------
    text
        Formula, for example ``G (speed <= limit + 1 km/h)``.

    Raises
    ------
    ValueError
        One line: column, text at this place, problem, remedy.

    Examples
    --------
    >>> parse_formula("F[0, 2 min] speed >= 36 km/h").window
    Window(begin=0.0, end=120.0)
    >>> parse_formula("G speed <= 200 kN")
    Traceback (most recent call last):
    ValueError: column 9: '<=': compares m/s with N; compare quantities of one unit
    """
    if len(text) > MAX_LENGTH:
        raise ValueError(f"formula of {len(text)} characters, at most {MAX_LENGTH}; divide it into several")
    return _Parser(text).formula()


class _Parser:
    def __init__(self, text: str) -> None:
        self._tokens = _tokens(text)
        self._at = self._depth = 0

    @property
    def _next(self) -> _Token:
        return self._tokens[self._at]

    def _take(self) -> _Token:
        token = self._next
        self._at += 1
        return token

    def _expect(self, *texts: str) -> None:
        token = self._next
        if token.kind != "sign" or token.text not in texts:
            raise _fault(token, f"expected '{texts[0]}'; add it")
        self._take()

    def formula(self) -> Formula:
        """Return the whole text as a formula."""
        node = self._expression(0)
        if self._next.kind != "end":
            raise _fault(self._next, "expected an operator or the end of the formula; correct or remove it")
        formula = _as_formula(node, self._tokens[0])
        if not signals_of(formula):
            raise _fault(self._tokens[0], "the formula has no signal; compare a signal, for example 'speed <= limit'")
        return formula

    def _expression(self, power: int) -> Term | Formula:
        """Return the expression up to the next operator that binds no stronger than ``power``."""
        self._depth += 1
        if self._depth > MAX_DEPTH:
            raise _fault(self._next, f"more than {MAX_DEPTH} nested operators; divide the formula")
        left = self._prefix()
        while (binding := _BINARY.get(self._next.text, 0)) > power and self._next.kind in ("sign", "name"):
            left = self._infix(left, binding)
        self._depth -= 1
        return left

    def _prefix(self) -> Term | Formula:
        token = self._take()
        if token.kind == "number":
            return NumberTerm(token.value, token.dimension)
        if token.text == "(":
            inner = self._expression(0)
            self._expect(")")
            return inner
        if token.text == "-":
            operand = _as_term(self._expression(_SIGN), token)
            return ArithmeticTerm("-", NumberTerm(0.0, None), operand, operand.dimension)
        if token.text == "not":
            return Negation(_as_formula(self._expression(_UNARY), token))
        if token.text in _TEMPORAL:
            window = self._window()
            return Temporal(token.text, window, _as_formula(self._expression(_UNARY), token))
        if token.text == "abs":
            self._expect("(")
            operand = _as_term(self._expression(0), token)
            self._expect(")")
            return AbsTerm(operand, operand.dimension)
        if token.kind == "name":
            found = find_signal(token.text)
            if found is None:
                near = close_match(token.text, (*SIGNALS, "and", "or", "not"))
                raise _fault(token, f"unknown signal{near}; signals: {', '.join(SIGNALS)}")
            return SignalTerm(token.text, dimension_of(found[0].unit))
        raise _fault(token, "expected a signal, a number or an operator; correct the formula")

    def _infix(self, left: Term | Formula, binding: int) -> Term | Formula:
        token = self._take()
        if token.text in ("U", "S"):
            window = self._window()
            then = _as_formula(self._expression(binding), token)
            return Until(token.text, window, _as_formula(left, token), then)
        right = self._expression(binding - 1 if token.text == "->" else binding)
        if binding < _UNARY:
            return Connective(token.text, _as_formula(left, token), _as_formula(right, token))
        first, second = _as_term(left, token), _as_term(right, token)
        if token.text in ("*", "/"):
            sign = 1 if token.text == "*" else -1
            dimension = product(first.dimension or NO_DIMENSION, second.dimension or NO_DIMENSION, sign)
            return ArithmeticTerm(token.text, first, second, dimension)
        dimension_ = _common(first, second, token)
        if token.text in ("+", "-"):
            return ArithmeticTerm(token.text, first, second, dimension_)
        return Predicate("<=" if token.text.startswith("<") else ">=", first, second)

    def _window(self) -> Window:
        """Return the interval at this place, ``[begin, end]``; without one the rest of the run."""
        if self._next.text != "[":
            return Window()
        opening = self._take()
        begin = self._time()
        self._expect(",", ":")
        end = self._time()
        self._expect("]")
        if not begin <= end or math.isinf(begin):
            raise _fault(opening, f"the interval begins at {begin:g} s and ends at {end:g} s; exchange them")
        return Window(begin, end)

    def _time(self) -> float:
        """Return a limit of an interval [s]; ``end`` is the end of the run."""
        token = self._take()
        if token.text == "end":
            return math.inf
        if token.kind != "number":
            raise _fault(token, "expected a time in seconds, or 'end'; correct the interval")
        if token.dimension not in (None, NO_DIMENSION, UNITS["s"][0]):
            raise _fault(token, "is no time; write seconds, 's' or 'min'")
        return token.value


def _tokens(text: str) -> list[_Token]:
    found: list[_Token] = []
    at = _SPACE.match(text).end()  # type: ignore[union-attr]
    while at < len(text):
        column = at + 1
        if number := _NUMBER.match(text, at):
            at, token = _number(text, number, column)
            found.append(token)
        elif match := _NAME.match(text, at) or _SIGNS.match(text, at):
            word = _WORDS.get(match[0], match[0])
            kind = "name" if _NAME.fullmatch(match[0]) and word == match[0] else "sign"
            if word in ("==", "!=", "="):
                raise _fault(_Token("sign", word, column), "is no comparison of samples; write abs(a - b) <= tolerance")
            found.append(_Token(kind, word, column))
            at = match.end()
        else:
            raise _fault(_Token("sign", text[at], column), "unknown character; remove it")
        at = _SPACE.match(text, at).end()  # type: ignore[union-attr]
    return [*found, _Token("end", "", len(text) + 1)]


def _number(text: str, number: re.Match[str], column: int) -> tuple[int, _Token]:
    """Return the end of a number with its unit, and its token."""
    value, at = float(number[0]), number.end()
    if not math.isfinite(value):
        raise _fault(_Token("number", number[0], column), "is too large; correct it")
    place = _SPACE.match(text, at).end()  # type: ignore[union-attr]
    unit = _unit_at(text, place)
    if unit is None:
        word = _NAME.match(text, place)
        known = word is None or word[0] in _BINARY or word[0] in _WORDS or word[0] in ("and", "or")
        if not known and find_signal(word[0]) is None:  # type: ignore[index]
            message = f"unknown unit{close_match(word[0], UNITS)}; use {', '.join(_LISTED)}"  # type: ignore[index]
            raise _fault(_Token("name", word[0], place + 1), message)  # type: ignore[index]
        return at, _Token("number", number[0], column, value, None if value == 0.0 else NO_DIMENSION)
    dimension, divisor = UNITS[unit]
    return place + len(unit), _Token(
        "number", text[number.start() : place + len(unit)], column, value / divisor, dimension
    )


_LISTED = tuple(unit for unit in UNITS if not re.search(r"\^|[a-z]\d", unit))
"""Units in messages, each in one spelling."""


def _unit_at(text: str, place: int) -> str | None:
    """Return the longest unit at a place that no letter or digit follows: ``m`` in ``5 m/speed``."""
    found = UNIT_PATTERN.match(text, place)
    while found is not None:
        follower = text[found.end() : found.end() + 1]
        if not (follower.isalnum() or follower == "_") or found[0][-1] in "%‰":
            return found[0]
        found = UNIT_PATTERN.match(text, place, found.end() - 1)
    return None


def _common(left: Term, right: Term, token: _Token) -> Exponents | None:
    """Return the dimension of two terms that are compared, added or subtracted."""
    if left.dimension is None or right.dimension is None:
        return left.dimension if right.dimension is None else right.dimension
    if left.dimension != right.dimension:
        verb = "compares" if token.text in ("<", ">", "<=", ">=") else "adds"
        units = [unit_text(term.dimension or NO_DIMENSION) for term in (left, right)]
        if "" in units:
            unit = next(entry for entry in units if entry)
            raise _fault(token, f"{verb} {unit} and a number without unit; write the unit, for example '5 {unit}'")
        raise _fault(token, f"{verb} {units[0]} with {units[1]}; compare quantities of one unit")
    return left.dimension


def _as_term(node: Term | Formula, token: _Token) -> Term:
    if not isinstance(node, Term):
        raise _fault(token, "has a formula as operand; use a signal or a number there")
    return node


def _as_formula(node: Term | Formula, token: _Token) -> Formula:
    if isinstance(node, Term):
        raise _fault(token, "has a number or signal as operand; compare it, for example 'speed <= limit'")
    return node


def _fault(token: _Token, problem: str) -> ValueError:
    shown = f"'{token.text}'" if token.text else "end of the formula"
    return ValueError(f"column {token.column}: {shown}: {problem}")
