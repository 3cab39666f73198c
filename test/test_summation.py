"""Sums of a run have the same bits in every version of Python."""

import ast
import re
import sys
from operator import mul
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from plant_sim.compiled import compiled
from plant_sim.elementary import cos_each, exp_each, plain_dot, plain_sum, sin_each, tanh_each
from plant_sim.railway import adhesion_by_speed, between_entries, envelope_force, fading_resistance, shoe_force

ROOT = Path(__file__).resolve().parents[1]
LAYERS = (
    "plant_sim",
    *(f"train_ato/{part}" for part in ("messages", "supervision", "control", "profile", "scenario", "judge", "loop")),
)
"""Layers with the numbers of a run."""
EXACT = {
    "plant_sim/consist.py": {"sum((part.count for part in self.train))"},
    "plant_sim/formats/railtoolkit.py": {"sum((vehicle.powered for vehicle in vehicles))"},
    "train_ato/control/algorithms/coupler_modes.py": {
        "sum(parted[:number])", "sum(modes.damped_by_loop(dead_time(model), outlast=True))",
    },
    "train_ato/control/algorithms/train_constants.py": {"sum((sides for _, sides in groups))"},
    "train_ato/judge/kept_samples.py": {
        "sum((values.nbytes for values in samples.values.values()))",
        "sum((time.size for time in self._topics[topic].times))",
        "sum((values.nbytes for values in self._cached.values()))",
        "sum((part.shape[0] for part in parts))",
    },
    "train_ato/judge/tracking.py": {
        "sum((max((_correlation(part, lag) for lag in lags)) >= CORRELATION for part in parts))"
    },
    "train_ato/judge/metrics.py": {"sum((totals.get(name, 0) for name in names))"},
    "train_ato/judge/ranking.py": {"sum((row['passed'] is False for row in metrics.get('criteria') or ()))"},
    "train_ato/judge/recording.py": {"sum((part.nbytes for part in parts if part is not None))"},
    "train_ato/messages/variable_codec.py": {"sum(map(len, self._keys.values()))"},
    "train_ato/loop/train_protection.py": {"sum((age > bound for bound in self._bounds))"},
    "train_ato/supervision/track_supervision.py": {"sum((limits.arcs.size for limits in self.targets))"},
}  # fmt: skip
"""Sums of integers and of truth values."""
ARRAYS = {
    "train_ato/profile/planner/train_tables.py": {
        "sum((envelope.forces(speed) for envelope in self._traction))",
        "sum(self._tabulated(self._traction))",
        "sum((np.minimum(whole, part) for whole, part in pairs))",
        "sum((np.maximum(whole - part, 0.0) for whole, part in pairs))",
    }
}
"""Sums of numpy arrays: added in order in every version."""
BOUNDS = {
    "train_ato/control/guard.py": {
        "sum(map(abs, preview.position.tolist()))",
        "sum(map(abs, preview.velocity.tolist()))",
        "sum(map(abs, preview.acceleration.tolist()))",
    }
}
"""Sums compared with a bound that is far from every physical value; their last bits reach no number."""
BY_PROCESSOR = re.compile(r"np\.(dot|vdot|inner|convolve|correlate|poly|exp|sin|cos|tanh|linalg\.\w+)")
"""Functions of numpy with other last bits on other processors."""
ELSEWHERE = {
    "plant_sim/alignment.py": {
        "np.cos(heading + turn / 2)", "np.cos(latitude[0])", "np.sin(heading + turn / 2)", "np.sin(yaw)", "np.cos(yaw)",
        "np.sin(pitch)", "np.cos(pitch)", "np.cos(self.heading)", "np.sin(self.heading)", "np.cos(self.slope)",
        "np.sin(self.slope)",
    },
    "train_ato/control/algorithms/linear_train.py": {
        "self.C @ np.linalg.solve(1j * w * unit - self.A, self.B)", "np.linalg.solve(1j * w * unit - self.A, self.B)",
        "np.exp(-1j * w * late)", "np.linalg.eigvals(self.A)",
    },
    "train_ato/control/algorithms/loop_gains.py": {
        "np.cos(np.minimum(phase, math.pi))", "np.exp(-s * (delay + 0.5 * period))", "np.exp(-s * delay)",
    },
    "train_ato/control/laws/gpc.py": {"np.exp(-s * sampling)", "np.exp(0.5 * s * period)"},
    "train_ato/control/train_model.py": {
        "np.convolve(np.pad(specific, width, mode='edge'), np.full(width, 1 / width), mode='same')"
    },
    "train_ato/scenario/dimensions.py": {
        "np.exp(np.log(self.low) + share * (np.log(self.high) - np.log(self.low)))"
    },
}  # fmt: skip
"""The map, the check of impossible values (see :data:`BOUNDS`), the linear model for users, the margin of gains before
a run, which is no number of it, a moving mean that has had the same bits on every processor so far, and a point of a
study, which its scenario records."""
NEWER_TYPES = {"Self", "Never", "LiteralString", "Required", "NotRequired", "Unpack", "TypeVarTuple", "override",
               "assert_never", "assert_type", "reveal_type", "dataclass_transform", "StrEnum"}  # fmt: skip
"""Names of ``typing`` and ``enum`` that Python 3.10 does not have."""


def sources(words: str, *folders: str) -> dict[str, ast.Module]:
    """Return the syntax tree of every source file of some folders whose text has a pattern."""
    return {
        str(path.relative_to(ROOT)): ast.parse(text)
        for folder in folders
        for path in sorted((ROOT / folder).rglob("*.py"))
        if re.search(words, text := path.read_text(encoding="utf-8"))
    }


def sums(tree: ast.Module) -> set[str]:
    """Return the calls of the built-in ``sum`` as text."""
    calls = {node for node in ast.walk(tree) if isinstance(node, ast.Call) and ast.unparse(node.func) == "sum"}
    return {ast.unparse(node) for node in calls}


def test_no_sum_of_floats_in_the_layers_of_a_run() -> None:
    """Breaks if a built-in sum() of floats is added: its last bits differ from Python 3.12 on; use plain_sum."""
    tables = (EXACT, ARRAYS, BOUNDS)
    allowed = {file: set().union(*(table.get(file, set()) for table in tables)) for file in EXACT | ARRAYS | BOUNDS}
    found = {file: calls for file, tree in sources(r"(?<![\w.])sum\(", *LAYERS).items() if (calls := sums(tree))}
    assert found == allowed


def products(tree: ast.Module) -> set[str]:
    """Return the products of ``@`` and the calls of numpy whose bits depend on the processor, as text."""
    found = {node for node in ast.walk(tree) if isinstance(node, ast.BinOp) and isinstance(node.op, ast.MatMult)}
    called = (node for node in ast.walk(tree) if isinstance(node, ast.Call))
    calls = {node for node in called if BY_PROCESSOR.fullmatch(ast.unparse(node.func))}
    return {ast.unparse(node) for node in found | calls}


def test_no_product_of_the_processor_in_a_plant_or_law() -> None:
    """Breaks if a run needs OpenBLAS or a vector function of numpy: its last bits differ on another processor."""
    layers = [folder for folder in LAYERS if folder != "train_ato/profile"]  # plans are data of a run, and made once
    named = sources(rf"{BY_PROCESSOR.pattern}|\s@\s", *layers)
    found = {file: calls for file, tree in named.items() if (calls := products(tree))}
    assert found == ELSEWHERE


def test_no_name_newer_than_python_3_10() -> None:
    """Breaks if a module cannot be imported in Python 3.10, which ruff does not see."""
    folders = ("plant_sim", "train_ato", "bench", "msgs_docs", "examples")
    newer = {
        f"{file}: {alias.name}"
        for file, tree in sources("|".join(NEWER_TYPES), *folders).items()
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and node.module in ("typing", "enum")
        for alias in node.names
        if alias.name in NEWER_TYPES
    }
    assert newer == set()


@given(st.lists(st.floats(-1e9, 1e9), max_size=20))
def test_plain_sum_adds_in_order(values: list[float]) -> None:
    """Breaks if the sum is compensated or in another order; in Python 3.10 and 3.11 the built-in one is equal."""
    total = np.float64(0.0)
    for value in values:
        total = total + np.float64(value)
    assert plain_sum(values) == plain_sum(iter(values)) == float(total)
    assert plain_sum([1.0, 1e-16, 1e-16]) == 1.0, "a compensated sum is another one"
    if sys.version_info < (3, 12):
        assert plain_sum(values) == sum(values)


@given(st.lists(st.tuples(st.floats(-1e6, 1e6), st.floats(-1e6, 1e6)), max_size=20))
def test_plain_dot_is_the_plain_sum_of_the_products(pairs: list[tuple[float, float]]) -> None:
    """Breaks if a product is fused with the addition or left out."""
    one, other = [a for a, _ in pairs], [b for _, b in pairs]
    assert plain_dot(one, other) == plain_sum(map(mul, one, other))


@pytest.mark.parametrize(
    ("each", "name"), [(exp_each, "exp"), (sin_each, "sin"), (cos_each, "cos"), (tanh_each, "tanh")]
)
def test_functions_have_the_bits_of_the_c_library(each, name: str) -> None:
    """Breaks if the compiler replaces the C library by a vector library with other last bits."""
    import math

    values = np.random.default_rng(1).uniform(-30.0, 30.0, 20_000)
    assert each(values).tobytes() == np.array([getattr(math, name)(value) for value in values.tolist()]).tobytes()


TABLE = [3.0, 5.0, 4.0]
ROWS = [(2.0, 10.0, -1.0, 0.0), (50.0, 0.0, 0.0, 60.0)]


def laws_of_the_railway(table, rows, v):
    """Return the laws of the railway at a speed."""
    at = abs(v)
    ends = fading_resistance(10.0, 2.0, 1.0, v), between_entries(table, v), envelope_force(rows, 0, 2, at)
    return shoe_force(300.0, v), adhesion_by_speed(at), ends[0], ends[1], ends[2]


@pytest.mark.parametrize(
    ("speed", "expected"),
    [
        (0.0, (300.0, 0.161 + 7.5 / 44, 0.0, 3.0, 10.0)),
        (1.5, (300 * 160.8 / 166.2, 0.161 + 7.5 / 49.4, 10 + 3 + 2.25, 4.5, 8.5)),
        (-12.5, (300 * 240 / 285, 0.161 + 7.5 / 89, -(10 + 25 + 156.25), 3.0, 4.8)),
        (60.0, (300 * 582 / 798, 0.161 + 7.5 / 260, 10 + 120 + 3600, 4.0, 0.0)),
    ],
)
def test_laws_of_the_railway_are_those_of_a_calculation_by_hand(speed: float, expected: tuple[float, ...]) -> None:
    """Breaks if a law of the railway has another number, or other bits in compiled code than in Python."""
    found = laws_of_the_railway(TABLE, ROWS, speed)
    assert found == pytest.approx(expected, rel=1e-12)
    assert compiled(laws_of_the_railway)(np.array(TABLE), np.array(ROWS), speed) == found
