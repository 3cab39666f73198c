"""Generate the JSON Schemas of all files, and the reference of the site: keys, commands, Python, metrics, error texts.

Editors complete and check a file that begins with ``# yaml-language-server: $schema=...``.
"""

import argparse
import ast
import json
import re
from collections.abc import Iterator, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from msgs_docs.generate.rows import rows_text, table_lines
from plant_sim.consist import Consist
from plant_sim.line import Line
from plant_sim.units import QUANTITY_KINDS, number_text
from train_ato.api.import_csv.layout import RecorderLayout
from train_ato.control.learned_resistance import LearnedResistance
from train_ato.profile.planner.timing_points import JourneyFile
from train_ato.scenario.criteria import Expectation
from train_ato.scenario.following import FollowingSpec
from train_ato.scenario.scenario import Scenario

MODELS: dict[str, type[BaseModel]] = {
    "scenario": Scenario, "following": FollowingSpec, "consist": Consist, "line": Line, "journey": JourneyFile,
    "learned": LearnedResistance, "recorder": RecorderLayout,
}  # fmt: skip


def schema_text(name: str) -> str:
    """Return the JSON Schema of one kind of file."""
    schema = MODELS[name].model_json_schema(by_alias=True)
    schema["$schema"] = "https://json-schema.org/draft/2020-12/schema"
    if name == "scenario":
        # Keys of files only; they are resolved before validation.
        schema["properties"]["base"] = {
            "type": "string",
            "description": "scenario that this one is laid over",
            "examples": ["demo"],
        }
        schema["$defs"]["Expectation"] = Expectation.model_json_schema()
        forms = [{"const": "passed"}, {"$ref": "#/$defs/Expectation"}]
        text = "expected verdict without changes; every variant states its own"
        schema["properties"]["expect"] = {"anyOf": forms, "description": text, "examples": ["passed"]}
        schema["properties"]["variants"] = {
            "type": ["object", "null"],
            "description": "overlays by name; null: none",
            "examples": [{"heavy": {"summary": "20 % more mass", "plant": {"mismatch": {"mass_scale": 1.2}}}}],
        }
        # The base of a scenario may have all other keys.
        schema["required"] = ["schema"]
        schema.pop("allOf", None)
        schema["$defs"]["PlantBlock"].pop("required", None)
    return rows_text(schema, 4) + "\n"


def schema_path(name: str) -> Path:
    """Return the path of a shipped schema."""
    return Path(str(files("train_ato"))) / "scenario" / "schemas" / f"{name}.schema.json"


SUFFIXES = tuple(f"_{suffix}" for kind in QUANTITY_KINDS for suffix, _ in kind.__metadata__[0].suffixes)
"""Suffixes of the keys that give a quantity in another unit."""
ERRORS = ("ValueError", "InputError", "RunFailed", "PlanError")
Schema = dict[str, Any]


def pages(top: Path) -> dict[str, str]:
    """Return the text of every page of the reference by its name."""
    files = {f"keys_{kind}": keys_page(kind) for kind in MODELS}
    return {
        **files,
        "commands": commands_page(),
        "python": python_page(),
        "metrics": metrics_page(),
        "errors": errors_page(top),
    }


def as_cell(text: object) -> str:
    """Return a text as a cell of a table."""
    return re.sub(r"([|<*])", r"\\\1", " ".join(str(text).split()))


def as_code(value: object) -> str:
    """Return a value as YAML on one line, in a cell of a table."""
    return f"`{json.dumps(value, ensure_ascii=False)}`"


def as_table(heads: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> str:
    """Return a table."""
    return "\n".join([*table_lines(heads, rows), ""])


def keys_page(kind: str) -> str:
    """Return the page of every key of one kind of file: meaning, unit, values, default and example."""
    schema = json.loads(schema_text(kind))
    blocks: dict[str, list[str]] = {}
    _find_blocks(schema, "", schema.get("$defs", {}), blocks)
    text = (
        f"# Keys of a {kind} file\n\n{as_cell(schema.get('description', '')).partition('. ')[0].rstrip('.')}.\n\n"
        "A key is written in its SI unit; with a suffix it has another one: `mass` in kg or `mass_t` in t.\n\n"
        f"{_keys_table(schema, required=set(schema.get('required', ())))}"
    )
    order = {name: at for at, name in enumerate(("ProfileSpec",))}  # the block that a user writes first
    for name in sorted(blocks, key=lambda name: order.get(name, len(order))):
        block = schema["$defs"][name]
        places = ", ".join(f"`{place}`" for place in blocks[name][:4]) + (", ..." if len(blocks[name]) > 4 else "")
        text += f"\n## {name}\n\n{places}: {as_cell(block.get('description', ''))}\n\n"
        text += _keys_table(block, required=set(block.get("required", ())))
    return text


def _find_blocks(schema: Schema, place: str, definitions: Schema, found: dict[str, list[str]]) -> None:
    """Add every block of keys below a schema, with the places of a file that have it."""
    for key, value in schema.get("properties", {}).items():
        for name, suffix in _references(value, ""):
            path = f"{place}{key}{suffix}"
            known = name in found
            if path not in found.setdefault(name, []):
                found[name].append(path)
            if not known:
                _find_blocks(definitions[name], f"{path}.", definitions, found)


def _references(schema: Schema, suffix: str) -> Iterator[tuple[str, str]]:
    """Yield the blocks of a value and the suffix of their places: ``[]`` in a list, ``.NAME`` by name."""
    if "$ref" in schema:
        yield schema["$ref"].rpartition("/")[2], suffix
    for part in (*schema.get("anyOf", ()), *schema.get("oneOf", ())):
        yield from _references(part, suffix)
    if isinstance(schema.get("items"), dict):
        yield from _references(schema["items"], f"{suffix}[]")
    if isinstance(schema.get("additionalProperties"), dict):
        yield from _references(schema["additionalProperties"], f"{suffix}.NAME")


def _keys_table(block: Schema, required: set[str]) -> str:
    """Return the table of the keys of one block; a key with the suffix of a unit is in the row of its quantity."""
    properties = block.get("properties", {})
    rows = []
    for key, value in properties.items():
        if any(key.endswith(suffix) and key.removesuffix(suffix) in properties for suffix in SUFFIXES):
            continue
        also = [name for name in properties if name.startswith(f"{key}_") and name.removeprefix(key) in SUFFIXES]
        names = ", ".join(f"`{name}`" for name in (key, *also))
        default = "required" if key in required else as_code(value["default"]) if "default" in value else ""
        if len(default) > 60:
            default = "see its block"
        example = as_code(value["examples"][0]) if value.get("examples") else ""
        rows.append((names, as_cell(value.get("description", "")), as_cell(_values(value)), default, example))
    return as_table(("key", "meaning", "values", "default", "example"), rows) if rows else "No keys.\n"


def _values(value: Schema) -> str:
    """Return the permitted values of a key in words."""
    if "anyOf" in value or "oneOf" in value:
        kinds = [_values(part) for part in (*value.get("anyOf", ()), *value.get("oneOf", ()))]
        return " or ".join(dict.fromkeys(kinds))
    if "$ref" in value:
        name = str(value["$ref"]).rpartition("/")[2]
        return f"[{name}](#{name.lower()})"
    if "const" in value:
        return str(value["const"])
    if "enum" in value:
        return ", ".join(map(str, value["enum"]))
    kind = value.get("type", "")
    if kind == "array":
        items = value.get("items")
        return f"list of {_values(items)}" if items else "list"
    if kind == "object":
        by_name = value.get("additionalProperties")
        return f"by name: {_values(by_name)}" if isinstance(by_name, dict) else "block"
    limits = (("minimum", "≥"), ("exclusiveMinimum", ">"), ("maximum", "≤"), ("exclusiveMaximum", "<"))
    bounds = [f"{sign} {number_text(value[name])}" for name, sign in limits if name in value]
    words = {"null": "none", "string": "text", "boolean": "true or false", "integer": "whole number"}
    return " ".join([words.get(kind, kind) if isinstance(kind, str) else " or ".join(kind), ", ".join(bounds)]).strip()


def commands_page() -> str:
    """Return the page of every command and its options."""
    from train_ato.cli.main import command_line

    parser = command_line()
    text = "# Commands\n\n`train-ato COMMAND --help` prints the same in a terminal.\n"
    (commands,) = (action for action in parser._actions if isinstance(action, argparse._SubParsersAction))
    for name, command in commands.choices.items():
        command.declare()
        usage = re.sub(r"\s+", " ", command.format_usage().removeprefix("usage: "))
        rows = [
            (f"`{_words(action)}`", as_cell(_help(action, command.prog)))
            for action in command._actions
            if action.help not in (argparse.SUPPRESS, None) and action.dest != "help"
        ]
        text += f"\n## {name}\n\n{as_cell(command.description)}\n\n```text\n{usage}\n```\n\n"
        text += as_table(("argument", "meaning"), rows) if rows else ""
    return text


def _words(action: argparse.Action) -> str:
    """Return the words of an argument on a command line."""
    value = action.metavar or ("" if action.nargs == 0 else action.dest.upper())
    value = " ".join(value) if isinstance(value, tuple) else value
    return f"{', '.join(action.option_strings)} {value}".strip()


def _help(action: argparse.Action, program: str) -> str:
    """Return the help of an argument with its values in place."""
    values = {**vars(action), "prog": program}
    if action.choices is not None:
        values["choices"] = ", ".join(map(str, action.choices))
    return (action.help or "") % values


def python_page() -> str:
    """Return the page of the public Python names; Sphinx reads their docstrings."""
    import train_ato

    text = "# Python\n\n```python\nimport train_ato as ta\n```\n"
    public = [name for name in train_ato.__all__ if name != "__version__"]
    for name in sorted(public, key=lambda name: (name[0].isupper(), name)):
        kind = "autoclass" if isinstance(getattr(train_ato, name), type) else "autofunction"
        members = "   :members:\n" if kind == "autoclass" else ""
        text += f"\n## {name}\n\n```{{eval-rst}}\n.. {kind}:: train_ato.{name}\n{members}```\n"
    return text


def metrics_page() -> str:
    """Return the page of the metrics of a run."""
    from train_ato.judge.metric_names import METRICS

    rows = [(f"`{key}`", as_cell(name), as_cell(unit)) for key, (name, unit) in METRICS.items()]
    return f"# Metrics\n\nKeys of `summary.json` and of `run.metrics`.\n\n{as_table(('key', 'metric', 'unit'), rows)}"


def errors_page(top: Path) -> str:
    """Return the page of the error texts by module; `...` replaces a value."""
    text = (
        "# Error texts\n\nSearch for the words of a message. `...` replaces a name or a value. The line of a message\n"
        "begins with file and key, and ends with the remedy.\n"
    )
    for package in ("plant_sim", "train_ato"):
        for path in sorted((top / package).rglob("*.py")):
            found = dict.fromkeys(_messages(ast.parse(path.read_text(encoding="utf-8"))))
            if found:
                text += f"\n## {path.relative_to(top)}\n\n" + "".join(f"* {as_cell(line)}\n" for line in found)
    return text


def _messages(tree: ast.AST) -> Iterator[str]:
    """Yield the messages of the raised errors of a module."""
    for node in ast.walk(tree):
        call = node.exc if isinstance(node, ast.Raise) else None
        if isinstance(call, ast.Call) and isinstance(call.func, ast.Name) and call.func.id in ERRORS and call.args:
            text = _template(call.args[0])
            if len(re.findall(r"[a-z]{2,}", text)) > 1:
                yield text


def _template(value: ast.expr) -> str:
    """Return the text of an expression with `...` for its values."""
    if isinstance(value, ast.Constant) and isinstance(value.value, str):
        return value.value
    if isinstance(value, ast.JoinedStr):
        return "".join(map(_template, value.values))
    if isinstance(value, ast.BinOp):
        return _template(value.left) + _template(value.right)
    return "..."
