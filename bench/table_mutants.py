"""Mutants of tables: a wrong last digit in each number outside functions, and each True or False exchanged.

The numbers of the standards are in tables and defaults of modules and classes, which mutmut does not change. A mutant
is imported in a fork of a process that has loaded the third-party packages and the plant, but no module of
``train_ato``.
"""

import ast
import importlib
import importlib.machinery
import importlib.util
import os
import resource
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import CodeType, ModuleType

LOADED = ("hypothesis.strategies", "matplotlib.pyplot", "pydantic", "pytest", "rich", "plant_sim.train")
WHOLE_RUNS = "not on_the_intervention_curve and not reaches_the_law"
"""Tests that drive whole trains, which takes a minute each without the compiler."""
OPTIONS = ("-x", "-p", "no:cacheprovider", "--hypothesis-profile=first_failure", "-k", WHOLE_RUNS)
"""Options of pytest: the first failure ends the tests, without a search for a smaller example."""
LIMIT_FACTOR, LIMIT_EXTRA = 4.0, 20.0
"""Limit of the CPU time of a mutant: factor of that without a mutation, and extra time [s]."""
MEMORY = 6 * 2**30
"""Largest address space of a mutant [bytes]: a loop without an end also fills lists."""


@dataclass(frozen=True)
class TableMutant:
    """Constant outside functions with another value."""

    path: str
    line: int
    column: int
    end: int
    text: str

    @property
    def name(self) -> str:
        """Return the name of the mutant in a sample."""
        return f"{self.path}:{self.line}:{self.column}"

    def source(self, source: str) -> str:
        """Return the source with the other value."""
        lines = source.splitlines(keepends=True)
        row = lines[self.line - 1].encode()
        lines[self.line - 1] = (row[: self.column] + self.text.encode() + row[self.end :]).decode()
        return "".join(lines)


def other_value(text: str) -> str:
    """Return a number with another last digit, the exponent unchanged; a whole number becomes one larger.

    >>> [other_value(text) for text in ("16.85", "-6.30e-7", "0.19", "900.0", "9", "True")]
    ['16.86', '-6.31e-7', '0.18', '901.0', '10', 'False']
    """
    if text in ("True", "False"):
        return str(text == "False")
    mantissa, exponent = (*text.split("e"), "")[:2]
    tail = f"e{exponent}" if exponent else ""
    whole, point, digits = mantissa.partition(".")
    if not digits.strip("0") and len(digits) < 2:
        return f"{int(whole) + 1}{point}{digits}{tail}"
    last = int(digits[-1])
    return f"{whole}.{digits[:-1]}{last - 1 if last == 9 else last + 1}{tail}"


def table_mutants(path: str, source: str) -> Iterator[TableMutant]:
    """Yield a mutant for each number, True and False that is in no function and no decorator."""

    def constants(node: ast.AST) -> Iterator[ast.Constant]:
        if isinstance(node, (ast.FunctionDef, ast.Lambda)):
            return
        if isinstance(node, ast.Constant) and isinstance(node.value, (bool, int, float)):
            yield node
        decorators = node.decorator_list if isinstance(node, ast.ClassDef) else []
        for child in ast.iter_child_nodes(node):
            if child not in decorators:
                yield from constants(child)

    for node in constants(ast.parse(source)):
        assert node.end_col_offset is not None
        text = ast.get_source_segment(source, node)
        assert text is not None
        yield TableMutant(path, node.lineno, node.col_offset, node.end_col_offset, other_value(text))


class _MutantLoader(importlib.machinery.SourceFileLoader):
    """Finder and loader of one module with another source."""

    def __init__(self, fullname: str, path: str, source: str) -> None:
        super().__init__(fullname, path)
        self.source = source

    def get_code(self, fullname: str) -> CodeType:
        return compile(self.source, self.path, "exec")

    def find_spec(self, name: str, path: object = None, target: ModuleType | None = None) -> object:
        return importlib.util.spec_from_file_location(name, self.path, loader=self) if name == self.name else None


def outcome_of_tests(root: Path, tests: Sequence[str], path: str, source: str, limit: float) -> tuple[str, float]:
    """Run tests in a fork with one module from a source; return ``survived``, ``killed`` or ``timeout`` and CPU s."""
    child = os.fork()
    if child == 0:
        status = 3
        try:
            quiet = os.open(os.devnull, os.O_WRONLY)
            os.dup2(quiet, 1)
            os.dup2(quiet, 2)
            resource.setrlimit(resource.RLIMIT_CPU, (int(limit), int(limit) + 5))
            resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
            module = path.removesuffix(".py").replace("/", ".")
            sys.meta_path.insert(0, _MutantLoader(module, str(root / path), source))  # type: ignore[arg-type]
            pytest = importlib.import_module("pytest")
            runs = (int(pytest.main([*OPTIONS, test])) for test in tests)
            status = next((failed for failed in runs if failed), 0)
        finally:
            os._exit(status)
    _, status, usage = os.wait4(child, 0)
    seconds = usage.ru_utime + usage.ru_stime
    if os.WIFSIGNALED(status):
        return "timeout", seconds
    return ("survived" if os.WEXITSTATUS(status) == 0 else "killed"), seconds


def run_table_mutants(root: Path, mutants: Sequence[TableMutant], tests: Sequence[str]) -> Iterator[str]:
    """Yield the outcome of each mutant; the working directory becomes the root of the project.

    Raises
    ------
    RuntimeError
        If the tests fail without a mutation.
    """
    os.chdir(root)
    sys.path.insert(0, str(root))
    for name in LOADED:
        importlib.import_module(name)
    early = [name for name in sys.modules if name.startswith("train_ato")]
    assert not early, f"loaded before the mutation: {early}"
    sources = {path: (root / path).read_text(encoding="utf-8") for path in {mutant.path for mutant in mutants}}
    path, source = next(iter(sources.items()))
    outcome, seconds = outcome_of_tests(root, tests, path, source, 3600.0)
    if outcome != "survived":
        raise RuntimeError("the tests fail without a mutation; repair them first")
    limit = LIMIT_FACTOR * seconds + LIMIT_EXTRA
    for mutant in mutants:
        yield outcome_of_tests(root, tests, mutant.path, mutant.source(sources[mutant.path]), limit)[0]
