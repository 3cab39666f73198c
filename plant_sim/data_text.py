"""Data from YAML and JSON text of unknown origin, with limits on nesting, aliases and repeated keys.

Scalars are those of the core schema of YAML 1.2: ``0500`` is 500; ``8:15``, ``NO`` and a date are text. PyYAML alone
reads the octal number 320, 495 minutes, false and a date. A number may have ``_`` between its digits.

The C loader of PyYAML composes nested nodes by recursion in C: 50 000 brackets overflow the stack and end the process.
Here the parser in C delivers events, and Python composes them within a limit on the depth.
"""

import json
import pickle
import re
from functools import lru_cache
from typing import Any

import yaml

from plant_sim.units import without_comma

MAX_NESTING = 100
"""Largest depth of nested values."""
_TOO_DEEP = f"nested deeper than {MAX_NESTING} levels"
_PARSER_TOO_DEEP = "exceeded maximum nesting depth"
"""Problem of the parser in C of PyYAML 6.0.4, which reads ahead of the composer and has a limit of its own."""
_PLAIN = (
    (_PARSER_TOO_DEEP, _TOO_DEEP),
    ("found unhashable key", "a key is a list or a block; write a text"),
    ("could not determine a constructor for the tag", "unknown tag"),
)
"""Problems of PyYAML in plain words."""
MAX_ALIASES = 50
"""Largest number of aliases in a text; many aliases expand to a size far beyond that of the text."""

_INTEGER = re.compile(r"^[-+]?[0-9][0-9_]*$|^0o[0-7]+$|^0x[0-9a-fA-F]+$")
_SCALARS: tuple[tuple[str, re.Pattern[str], list[str]], ...] = (
    ("bool", re.compile(r"^(?:true|True|TRUE|false|False|FALSE)$"), list("tTfF")),
    ("null", re.compile(r"^(?:~|null|Null|NULL|)$"), ["~", "n", "N", ""]),
    ("int", _INTEGER, list("-+0123456789")),
    (
        "float",
        re.compile(
            r"^[-+]?(?:\.[0-9]+|[0-9][0-9_]*(?:\.[0-9_]*)?)(?:[eE][-+]?[0-9]+)?$"
            r"|^[-+]?\.(?:inf|Inf|INF)$|^\.(?:nan|NaN|NAN)$"
        ),
        list("-+.0123456789"),
    ),
    ("merge", re.compile(r"^<<$"), ["<"]),
)
"""Type, text and first characters of the plain scalars that are not text."""
MAX_DIGITS = 400
"""Largest number of digits of an integer: more than of the largest floating-point number."""
SHORT = 50_000
"""Length of the texts whose data are kept; to parse them again takes 100 times as long as to copy them."""
_Base: Any = getattr(yaml.cyaml, "CParser", None) if yaml.__with_libyaml__ else None
_PYTHON = (yaml.reader.Reader, yaml.scanner.Scanner, yaml.parser.Parser)
_PARSERS: tuple[Any, ...] = _PYTHON if _Base is None else (_Base,)


class _LimitedComposer(yaml.composer.Composer):
    """Composer that counts the depth and the aliases."""

    _aliases = 0
    _depth = 0

    def compose_node(self, parent: Any, index: Any) -> Any:
        """Compose a node within the limits."""
        if self.check_event(yaml.AliasEvent):  # type: ignore[attr-defined]  # a method of the parser
            self._aliases += 1
            if self._aliases > MAX_ALIASES:
                raise yaml.constructor.ConstructorError(
                    None, None, f"more than {MAX_ALIASES} aliases; write them out", None
                )
        self._depth += 1
        if self._depth > MAX_NESTING:
            raise yaml.constructor.ConstructorError(None, None, _TOO_DEEP, None)
        node = super().compose_node(parent, index)
        self._depth -= 1
        return node


class _UniqueKeys(yaml.constructor.SafeConstructor):
    """Safe constructor that rejects repeated keys."""

    def construct_mapping(self, node: Any, deep: bool = False) -> dict[Any, Any]:
        """Construct a mapping without repeated keys."""
        seen: set[str] = set()
        before = ""
        for key, value in node.value:
            text = str(key.value)
            if node.flow_style and value.value == "" and before and text.isdigit():
                problem = f"'{before},{text}' has a comma; write {without_comma(before, text)}"
                raise yaml.constructor.ConstructorError(None, None, problem, key.start_mark)
            before = value.value if isinstance(value, yaml.ScalarNode) and _INTEGER.match(value.value) else ""
            if text in seen and text != "<<":
                problem = f"key '{text}' is repeated"
                raise yaml.constructor.ConstructorError(None, None, problem, key.start_mark)
            seen.add(text)
        return super().construct_mapping(node, deep=deep)

    def construct_yaml_int(self, node: Any) -> int:
        """Construct an integer: decimal, ``0o17`` or ``0x1f``."""
        text = self._text(node, "int").replace("_", "")
        if len(text) > MAX_DIGITS:
            problem = f"an integer of {len(text)} digits; give at most {MAX_DIGITS}"
            raise yaml.constructor.ConstructorError(None, None, problem, node.start_mark)
        return int(text, {"0o": 8, "0x": 16}.get(text[:2], 10))

    def construct_yaml_float(self, node: Any) -> float:
        """Construct a number; also with its tag, 1:30 is none."""
        self._text(node, "float")
        return super().construct_yaml_float(node)

    def construct_yaml_bool(self, node: Any) -> bool:
        """Construct a truth value; also with its tag, yes is none."""
        return self._text(node, "bool").lower() == "true"

    def construct_yaml_null(self, node: Any) -> None:
        """Construct an empty value; also with its tag, a text is none."""
        self._text(node, "null")

    def _text(self, node: Any, kind: str) -> str:
        """Return the text of a scalar, which must be one of its type without a tag too."""
        text = str(self.construct_scalar(node))
        if not next(pattern for name, pattern, _ in _SCALARS if name == kind).match(text):
            problem = f"'{text[:40]}' is no value of the tag !!{kind}; remove the tag or correct the value"
            raise yaml.constructor.ConstructorError(None, None, problem, node.start_mark)
        return text


class _Loader(_LimitedComposer, *_PARSERS, _UniqueKeys, yaml.resolver.Resolver):  # type: ignore[misc]
    """YAML loader of this module."""

    def __init__(self, text: Any) -> None:
        _PARSERS[0].__init__(self, text)
        for base in _PARSERS[1:]:
            base.__init__(self)
        yaml.composer.Composer.__init__(self)
        yaml.constructor.SafeConstructor.__init__(self)
        yaml.resolver.Resolver.__init__(self)


def _add_scalars(target: Any) -> None:
    """Add the scalars of the core schema of YAML 1.2, and the merge key, to a loader or a dumper."""
    for tag, pattern, first in _SCALARS:
        target.add_implicit_resolver(f"tag:yaml.org,2002:{tag}", pattern, first)


_UniqueKeys.yaml_constructors = {
    f"tag:yaml.org,2002:{kind}": getattr(_UniqueKeys, f"construct_yaml_{kind}")
    for kind in ("null", "bool", "int", "float", "str", "seq", "map")
} | {None: _UniqueKeys.construct_undefined}
_Loader.yaml_implicit_resolvers = {}
_add_scalars(_Loader)


class TextDumper(yaml.SafeDumper):
    """Dumper that quotes every text which :func:`parse_yaml` would read as a number, such as ``08`` and ``1e5``."""


_add_scalars(TextDumper)


@lru_cache(64)
def _pickled(text: str | bytes) -> bytes:
    return pickle.dumps(yaml.load(text, Loader=_Loader))


def parse_yaml(text: str | bytes) -> Any:
    """Return the data of a YAML text; a short one, as the base of many scenarios, is parsed once.

    Raises
    ------
    ValueError
        Line number and problem, without remedy: not YAML, an unsafe tag, a repeated key, or a limit exceeded.
    """
    try:
        return pickle.loads(_pickled(text)) if len(text) < SHORT else yaml.load(text, Loader=_Loader)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        last = len(text.splitlines()) - 1  # the parser in C counts one line more at the end
        place = f"line {min(mark.line, last) + 1}: " if mark is not None else ""
        problem = getattr(error, "problem", None) or "not YAML"
        for theirs, plain in _PLAIN:
            problem = problem.replace(theirs, plain)
        raise ValueError(f"{place}{problem}") from None
    except (ValueError, ArithmeticError) as error:  # a date or a number that does not exist
        raise ValueError(f"{' '.join(str(error).split())[:200]}") from None


def parse_json(text: str | bytes) -> Any:
    """Return the data of a JSON text.

    Raises
    ------
    ValueError
        The problem, without remedy.
    """
    try:
        return json.loads(text, object_pairs_hook=_unique, parse_int=_integer)
    except RecursionError:
        raise ValueError("nested too deeply") from None


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Return an object of JSON without repeated keys."""
    found = dict(pairs)
    if len(found) < len(pairs):
        names = [name for name, _ in pairs]
        raise ValueError(f"key '{next(name for name in names if names.count(name) > 1)}' is repeated")
    return found


def _integer(text: str) -> int:
    if len(text) > MAX_DIGITS:
        raise ValueError(f"an integer of {len(text)} digits; give at most {MAX_DIGITS}")
    return int(text)
