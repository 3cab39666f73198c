"""The layers of the packages: every module imports only from its own layer and from lower ones."""

import ast
from collections.abc import Iterator
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import train_ato

ROOT = Path(__file__).resolve().parents[1]

LAYERS = (
    "plant_sim", "train_ato.program", "train_ato.messages", "train_ato.supervision", "train_ato.control",
    "train_ato.profile", "train_ato.scenario", "train_ato.judge", "train_ato.loop", "train_ato.log", "train_ato.ros",
    "train_ato.report", "train_ato.api", "train_ato.studies", "train_ato.playback", "train_ato.view",
    "train_ato.papers", "train_ato.cli", "train_ato", "train_ato.__main__",
)  # fmt: skip
"""Layers from lowest to highest; CONTRIBUTING.md describes them."""
CONTROL_LAYERS = (
    ("contract", "component_fault", "learned_resistance", "train_model", "gains",
     "plan_text"),
    ("guard",),
    ("algorithms",),
    ("mpc",),
    ("law",),
    ("air_brake",),
    ("observers", "compensation"),
    ("laws", "open_loop"),
    ("registry", "law_call"),
    ("force_distribution", "command_hold", "stack", "ato_state", "assurance",
     "plausibility", "takeover", "caller"),
)  # fmt: skip
"""Modules and packages of ``train_ato.control`` from lowest to highest; those of one layer may import each other."""
CONVENTIONS = {
    "finish": "end of the help of a command: one per module of train_ato.cli with such lines",
    "execute": "action of a command: one per module of train_ato.cli",
    "draw": "figures of a paper: one per paper",
    "page": "text of a page: one per kind of page in msgs_docs.generate",
    "measure": "runs of a table of a page and its figures: one per table in msgs_docs.generate",
    "unmeasured": "rows of such a table without current figures: one per table",
    "main": "start of a program: the command and the page generator",
}
"""Public names that several modules declare, each with one meaning; the caller chooses the module."""
NO_ROS = LAYERS[: LAYERS.index("train_ato.ros")]
"""Layers that must run where no ROS package is installed."""
ROS_MODULES = {
    "rclpy", "sensor_msgs", "trajectory_msgs", "std_srvs", "rosgraph_msgs", "diagnostic_msgs", "rcl_interfaces",
}  # fmt: skip


def module_name(path: Path) -> str:
    """Return the dotted name of a source file."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {module_name(path): path for package in ("plant_sim", "train_ato") for path in (ROOT / package).rglob("*.py")}


@cache
def tree(name: str) -> ast.Module:
    """Return the syntax tree of a module."""
    return ast.parse(MODULES[name].read_text(encoding="utf-8"))


def statements(node: ast.AST) -> Iterator[ast.AST]:
    """Yield the statements below a node; imports are never in expressions."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, (ast.stmt, ast.ExceptHandler, ast.match_case)):
            yield child
            yield from statements(child)


@cache
def imports(name: str) -> set[str]:
    """Return the modules that a module imports anywhere: at its top, in functions, for type checkers."""
    found = set()
    for node in statements(tree(name)):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{name}: relative import"
            for alias in node.names:
                full = f"{node.module}.{alias.name}"
                found.add(full if full in MODULES else str(node.module))
    return found


def layer(name: str) -> str:
    """Return the layer of a module: a package on the first level below ``train_ato``, or ``plant_sim``."""
    parts = name.split(".")
    return "plant_sim" if parts[0] == "plant_sim" else ".".join(parts[:2])


def ours(names: set[str]) -> set[str]:
    return {name for name in names if name in MODULES}


def test_a_module_imports_only_from_its_layer_and_lower_ones() -> None:
    """Breaks if an import points upward, also in ``train_ato.control``, functions or TYPE_CHECKING, or in a circle."""
    assert [name for name in MODULES if layer(name) not in LAYERS] == []
    whole = {name: LAYERS.index(layer(name)) for name in MODULES}
    inside = {name: control_layer(name) for name in MODULES if name.startswith(CONTROL)}
    for level in (whole, inside):
        assert [(name, to) for name in level for to in imports(name) & level.keys() if level[to] > level[name]] == []
    TopologicalSorter({name: ours(imports(name)) - {name} for name in MODULES}).prepare()  # names a circle


CONTROL = "train_ato.control."


def control_layer(name: str) -> int:
    """Return the layer of a module inside ``train_ato.control``; fails for a module that the list lacks."""
    part = name.removeprefix(CONTROL).partition(".")[0]
    (found,) = [index for index, parts in enumerate(CONTROL_LAYERS) if part in parts]
    return found


def test_ros_and_parts_of_one_layer_stay_apart() -> None:
    """Breaks if observers and compensations import each other, or physics, laws, loop or log need a ROS package."""
    for name in MODULES:
        for one, other in (("observers", "compensation"), ("compensation", "observers")):
            if name.startswith(CONTROL + one):
                assert not any(found.startswith(CONTROL + other) for found in ours(imports(name))), name
    lower = [(name, other) for name in MODULES if layer(name) in NO_ROS for other in imports(name)]
    assert [(name, other) for name, other in lower if other.partition(".")[0] in ROS_MODULES] == []


def test_a_public_name_has_one_meaning() -> None:
    """Breaks if two modules declare a public class or function of the same name."""
    declared: dict[str, set[str]] = {}
    for package in ("plant_sim", "train_ato", "msgs_docs"):
        for path in sorted((ROOT / package).rglob("*.py")):
            known = MODULES.get(module_name(path)) == path
            for node in (tree(module_name(path)) if known else ast.parse(path.read_text(encoding="utf-8"))).body:
                if isinstance(node, (ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)) and node.name[0] != "_":
                    declared.setdefault(node.name, set()).add(module_name(path))
    several = {name: modules for name, modules in declared.items() if len(modules) > 1}
    assert {name: modules for name, modules in several.items() if name not in CONVENTIONS} == {}
    assert several.keys() == CONVENTIONS.keys(), "a convention that nothing uses"


def test_few_functions_take_many_positional_parameters() -> None:
    """Breaks if a call with a row of bare values or a bare ``True`` becomes usual again; kernels take no keywords."""
    many, flags = [], []
    for name in MODULES:
        for node in ast.walk(tree(name)):
            if not isinstance(node, ast.FunctionDef) or any("compiled" in ast.dump(m) for m in node.decorator_list):
                continue
            given = [entry for entry in node.args.posonlyargs + node.args.args if entry.arg not in ("self", "cls")]
            typed = [entry for entry in given if entry.annotation is not None]
            many += [f"{name}.{node.name}"] if len(typed) > 5 else []
            flags += [f"{name}.{node.name}: {entry.arg}" for entry in typed if ast.unparse(entry.annotation) == "bool"]
    assert len(many) <= 25, many
    assert len(flags) <= 24, flags


def test_the_first_level_is_small() -> None:
    entries = [path for path in (ROOT / "train_ato").iterdir() if not path.name.startswith("__pycache__")]
    assert sum(path.is_dir() for path in entries) <= 17
    assert sum(path.suffix == ".py" for path in entries) <= 2
    layers = {layer(name) for name in MODULES}
    assert len(layers) <= 20
    # Python sets an imported package as attribute of train_ato: it would hide a function of the same name.
    assert {path.name for path in entries} & set(train_ato.__all__) == {"scenario"}
