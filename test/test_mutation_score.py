"""The mutation score: mutants of tables, the list of equivalent mutants, the verdict, and a random sample."""

import importlib.util
import json
import subprocess
import sys
from collections import Counter
from pathlib import Path
from types import ModuleType

import pytest

BENCH = Path(__file__).resolve().parents[1] / "bench"


def load(name: str) -> ModuleType:
    """Return a module of the folder bench/."""
    spec = importlib.util.spec_from_file_location(name, BENCH / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = sys.modules[name] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


tables, mutation = load("table_mutants"), load("mutation")

SOURCE = '''"""Text with 1."""
import x
A, B = 16.85, (-6.30e-7, {"a": 900.0})
@dataclass(frozen=True)
class C:
    value: float = 0.19
    flag: bool = False
    def method(self, k=3):
        return 4
def function():
    return 5
'''


def test_mutants_of_tables() -> None:
    """Breaks if a number of a module or class has no mutant, or one of a function, decorator or text has one."""
    found = [mutant.source(SOURCE) for mutant in tables.table_mutants("x.py", SOURCE)]
    changes = [("16.85", "16.86"), ("6.30", "6.31"), ("900", "901"), ("0.19", "0.18"), ("False", "True")]
    assert found == [SOURCE.replace(before, after) for before, after in changes]


@pytest.mark.parametrize(("survivors", "each", "status"), [(9, True, 0), (10, True, 1), (15, False, 0), (16, False, 1)])
def test_verdict(survivors: int, each: bool, status: int, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if a score below 91 % passes, below 85 % of a sample, or an equivalent mutant counts, a killed one not."""
    one = ("a.py", "f", "x = 1", "x = 2")
    outcomes = ["survived"] * survivors + ["killed"] * 80 + ["timeout"] * (20 - survivors)
    mutants = [mutation.Mutant("a.py", "f", f"x = {k}", "x = None", outcome) for k, outcome in enumerate(outcomes)]
    mutants += [mutation.Mutant(*one, "survived")] * 5 + [mutation.Mutant("b.py", "", "y", "z", "killed")]
    assert mutation.report(*mutation.counted(mutants, {one: "reason"}), each=each) == status
    lines = capsys.readouterr().out
    assert lines.count("x = None") == survivors
    killed, late = 101 - survivors, 20 - survivors
    found = lines.splitlines()[-1].split()
    assert found == ["all", "106", "5", f"{killed}", f"{late}", f"{survivors}", f"{100 * killed / 101:.1f}%"]


def test_equivalent_mutants_are_in_the_code() -> None:
    """Breaks if an equivalent mutant has no reason, or its lines were changed, so that the entry is without effect."""
    listed = mutation.equivalent_mutants()
    assert len(listed) > 10
    for (path, place, before, after), reason in listed.items():
        lines = [line.strip() for line in (BENCH.parent / path).read_text(encoding="utf-8").splitlines()]
        assert path in mutation.FILES and place and len(reason) > 10
        assert [line for line in before.splitlines() if line not in lines] == [], f"{path}: {place}"
        assert after != before


def test_page_has_the_score_of_every_file() -> None:
    """Breaks if the page of the hazards has another set of files than the score, or a file below the bound."""
    measured = json.loads(mutation.MEASURED.read_text(encoding="utf-8"))
    assert sorted(measured) == sorted(mutation.FILES)
    assert [path for path, outcomes in measured.items() if mutation.score(Counter(outcomes)) < mutation.BOUND] == []


def test_the_tests_of_the_score_are_there() -> None:
    """Breaks if a test file of the score was folded into another one: no mutant is run any more."""
    assert [name for name in mutation.TESTS if not (BENCH.parent / f"test/test_{name}.py").is_file()] == []


@pytest.mark.campaign
def test_score_of_a_sample() -> None:
    """Breaks if fewer than 85 % of random mutants of supervision and links fail a test."""
    pytest.importorskip("mutmut", reason="needs pip install mutmut")
    command = [sys.executable, str(BENCH / "mutation.py"), "--sample", "60"]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stdout[-3000:] + run.stderr[-1000:]
