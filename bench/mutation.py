"""Mutation score of the braking curves and the delay lines: the part of small faults that the tests find.

    python bench/mutation.py                       # all mutants, about an hour on one core
    python bench/mutation.py --sample 150          # random mutants, about 15 minutes
    python bench/mutation.py --only limits.py      # mutants of one file
    python bench/mutation.py --write               # all, and their numbers for msgs_docs/hazards.md

A mutant is the program with one small change. mutmut changes statements in functions, ``table_mutants.py`` the numbers
of tables and defaults. A mutant is killed if a test fails or exceeds its time limit (late); equivalent mutants, listed
with reasons in ``equivalent_mutants.yaml``, are left out. The exit status is 1 if the score of a file, or of the
sample, is below its bound. Needs ``pip install mutmut``.
"""

import argparse
import json
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import yaml
from table_mutants import OPTIONS, TableMutant, run_table_mutants, table_mutants

ROOT = Path(__file__).resolve().parents[1]
BOUND, SAMPLE_BOUND = 91.0, 85.0
"""Smallest score of a file, and of a sample, whose score is a few percent beside that of all mutants [%]."""
LEFT_OUT = ("__init__.py", "plant_brake.py", "train_report.py")
"""The tests of the last two drive whole trains."""
FILES = tuple(
    str(path.relative_to(ROOT))
    for path in (*sorted((ROOT / "train_ato/supervision").glob("*.py")), ROOT / "train_ato/messages/delay_lines.py")
    if path.name not in LEFT_OUT
)
TESTS = ("odometry", "supervisor", "link_threats", "curves_standard", "curves_files")
"""Test files in the order in which they run: the fast ones first."""
EQUIVALENT = Path(__file__).with_name("equivalent_mutants.yaml")
MEASURED = ROOT / "msgs_docs" / "mutation_measured.json"
"""Numbers of mutants by file and outcome, for the page of the hazards."""
TABLE = "table"
COMPILED = re.compile(r"^@(also_)?compiled\n", re.MULTILINE)
"""Decorators of compiled functions, which are the same without a compiler."""
KILLED = ("killed", "timeout", "segfault")
PARTS = ("train_ato", "plant_sim", "test", "msgs_docs", "examples", "setup.py", "setup.cfg", "pyproject.toml")
CONFIGURATION = """
[tool.mutmut]
source_paths = ["train_ato", "plant_sim"]
only_mutate = {files}
also_copy = ["msgs_docs", "examples", "setup.py"]
pytest_add_cli_args = {options}
pytest_add_cli_args_test_selection = {tests}
timeout_multiplier = 4.0
"""


@dataclass(frozen=True)
class Mutant:
    """Tested mutant: file, function or ``table``, changed lines, and outcome."""

    path: str
    place: str
    before: str
    after: str
    outcome: str

    @property
    def key(self) -> tuple[str, str, str, str]:
        """Identification in the list of equivalent mutants."""
        return self.path, self.place, self.before, self.after


def test_files() -> list[str]:
    """Return the paths of the test files."""
    return [f"test/test_{name}.py" for name in TESTS]


def copy_project(folder: Path, files: Sequence[str]) -> None:
    """Copy the project into a folder, with the configuration of mutmut; the compiled functions are plain ones there."""
    for part in PARTS:
        if (ROOT / part).is_dir():
            shutil.copytree(ROOT / part, folder / part, ignore=shutil.ignore_patterns("__pycache__", ".*"))
        else:
            shutil.copy(ROOT / part, folder / part)
    for path in files:  # mutmut leaves out functions with a decorator
        text = (folder / path).read_text(encoding="utf-8")
        (folder / path).write_text(COMPILED.sub("", text), encoding="utf-8")
    with (folder / "pyproject.toml").open("a", encoding="utf-8") as file:
        lists = {"files": files, "options": OPTIONS, "tests": test_files()}
        file.write(CONFIGURATION.format_map({key: json.dumps(value) for key, value in lists.items()}))


def function_mutants(folder: Path, *arguments: str, output: int | None = None) -> str:
    """Start ``function_mutants.py`` in the copy; return its output."""
    command = [sys.executable, str(Path(__file__).with_name("function_mutants.py")), *arguments]
    plain = {**os.environ, "NUMBA_DISABLE_JIT": "1"}
    run = subprocess.run(command, cwd=folder, stdout=output or sys.stderr, text=True, check=False, env=plain)
    if run.returncode:
        sys.exit(f"mutation.py: {folder}: mutmut ended with status {run.returncode}; see above")
    return run.stdout or ""


def tested(folder: Path, files: Sequence[str], sample: int | None, seed: int) -> list[Mutant]:
    """Return the outcomes of all mutants of files, or of a random sample."""
    if not (folder / "pyproject.toml").exists():
        copy_project(folder, files)
    sources = {path: (ROOT / path).read_text(encoding="utf-8") for path in files}
    tables = {mutant.name: mutant for path, source in sources.items() for mutant in table_mutants(path, source)}
    names: list[str] = json.loads(function_mutants(folder, "names", *files, output=subprocess.PIPE))
    if sample is not None:
        everything = [*names, *tables]
        chosen = set(random.Random(seed).sample(everything, min(sample, len(everything))))
        names, tables = [n for n in names if n in chosen], {n: t for n, t in tables.items() if n in chosen}
    found = []
    if names:
        function_mutants(folder, "run", "results.json", *(names if sample is not None else ()))
        found = [Mutant(**entry) for entry in json.loads((folder / "results.json").read_text())]
    return found + tested_tables(list(tables.values()), sources)


def tested_tables(mutants: Sequence[TableMutant], sources: dict[str, str]) -> list[Mutant]:
    """Return the outcomes of mutants of tables."""
    found = []
    outcomes = run_table_mutants(ROOT, mutants, test_files()) if mutants else iter(())
    for mutant, outcome in zip(mutants, outcomes, strict=True):
        before, after = (
            text.splitlines()[mutant.line - 1].strip()
            for text in (sources[mutant.path], mutant.source(sources[mutant.path]))
        )
        found.append(Mutant(mutant.path, TABLE, before, after, outcome))
        sys.stderr.write(f"\r{len(found)} of {len(mutants)} numbers of tables")
    return found


def score(outcomes: Counter[str]) -> float:
    """Return the part of killed mutants among those that are not equivalent [%]."""
    counted = outcomes.total() - outcomes["equivalent"]
    return 100.0 * sum(outcomes[name] for name in KILLED) / counted if counted else 100.0


def counted(
    mutants: Iterable[Mutant], equivalent: Mapping[tuple[str, str, str, str], str]
) -> tuple[dict[str, Counter[str]], list[Mutant]]:
    """Return the numbers of outcomes by file, and the survivors; an equivalent mutant that survives is none."""
    by_file: dict[str, Counter[str]] = {}
    survivors = []
    for mutant in mutants:
        alive = mutant.outcome not in KILLED
        outcome = "equivalent" if alive and mutant.key in equivalent else mutant.outcome
        by_file.setdefault(mutant.path, Counter())[outcome] += 1
        if alive and outcome != "equivalent":
            survivors.append(mutant)
    return dict(sorted(by_file.items())), survivors


def report(by_file: Mapping[str, Counter[str]], survivors: Sequence[Mutant], *, each: bool) -> int:
    """Print the table of the files and the survivors; return the exit status."""
    for mutant in survivors:
        print(f"\n{mutant.path}: {mutant.place}: {mutant.outcome}")
        print("\n".join([f"- {line}" for line in mutant.before.splitlines()]))
        print("\n".join([f"+ {line}" for line in mutant.after.splitlines()]))
    total = sum(by_file.values(), Counter())
    print(f"\n{'file':46}{'mutants':>8}{'equivalent':>11}{'killed':>8}{'of them late':>13}{'survived':>9}{'score':>8}")
    for path, outcomes in [*by_file.items(), ("all", total)]:
        killed, number = sum(outcomes[name] for name in KILLED), outcomes.total() - outcomes["equivalent"]
        print(f"{path:46}{outcomes.total():8}{outcomes['equivalent']:11}{killed:8}{killed - outcomes['killed']:13}"
              f"{number - killed:9}{score(outcomes):7.1f}%")  # fmt: skip
    if not each:
        return int(score(total) < SAMPLE_BOUND)
    return int(any(score(outcomes) < BOUND for outcomes in by_file.values()))


def equivalent_mutants() -> dict[tuple[str, str, str, str], str]:
    """Return the reasons of the equivalent mutants by file, function and changed lines."""
    entries = yaml.safe_load(EQUIVALENT.read_text(encoding="utf-8")) or []
    return {(e["file"], e["in"], e["before"].strip(), e["after"].strip()): e["reason"] for e in entries}


def main() -> int:
    """Run the command; return its exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sample", type=int, help="number of random mutants; default: all")
    parser.add_argument("--seed", type=int, default=1, help="seed of the sample")
    parser.add_argument(
        "--folder", type=Path, help="folder of the copy; with that of a stopped run mutmut continues it"
    )
    parser.add_argument("--only", nargs="+", metavar="NAME", help="names of files")
    parser.add_argument("--write", action="store_true", help=f"write {MEASURED.relative_to(ROOT)}, of all mutants")
    arguments = parser.parse_args()
    if arguments.write and (arguments.only or arguments.sample):
        parser.error("--write: the page has all mutants; remove --only and --sample")
    files = [path for path in FILES if not arguments.only or Path(path).name in arguments.only]
    if not files:
        parser.error(f"--only: no such file; choose from {', '.join(Path(path).name for path in FILES)}")
    with tempfile.TemporaryDirectory(prefix="mutation_") as name:
        folder = Path(name) if arguments.folder is None else arguments.folder
        folder.mkdir(parents=True, exist_ok=True)
        found = tested(folder.resolve(), files, arguments.sample, arguments.seed)
    by_file, survivors = counted(found, equivalent_mutants())
    if arguments.write:
        MEASURED.write_text(json.dumps(by_file, indent=1) + "\n", encoding="utf-8")
    return report(by_file, survivors, each=arguments.sample is None)


if __name__ == "__main__":
    sys.exit(main())
