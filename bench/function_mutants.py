"""Mutants in functions: mutmut 3 with three more operators, in a copy of the project that has its configuration.

    python function_mutants.py names FILE ...           # JSON list of the mutants of files
    python function_mutants.py run RESULTS [NAME ...]   # test mutants (default: all), write results as JSON

The added operators exchange ``min`` and ``max``, remove a call or ``raise`` that is a statement of its own, and negate
a condition without a comparison. ``mutation.py`` makes the copy and starts this file in it.
"""

import json
import resource
import sys
from collections.abc import Iterator
from pathlib import Path

import libcst as cst
from mutmut.__main__ import cli, walk_mutatable_files
from mutmut.mutation.data import SourceFileMutationData
from mutmut.mutation.diff_apply import get_diff_for_mutant
from mutmut.mutation.file_mutation import mutate_file_contents
from mutmut.mutation.mutators import mutation_operators
from mutmut.stats import status_by_exit_code
from mutmut.utils.format_utils import get_mutant_name, orig_function_and_class_names_from_key
from table_mutants import MEMORY


def exchanged_bound(node: cst.Call) -> Iterator[cst.Call]:
    """Yield ``min`` for ``max`` and the reverse."""
    other = {"min": "max", "max": "min"}
    if isinstance(node.func, cst.Name) and node.func.value in other:
        yield node.with_changes(func=cst.Name(other[node.func.value]))


def removed_statement(node: cst.Expr | cst.Raise) -> Iterator[cst.Pass]:
    """Yield nothing in place of a call or an error."""
    if isinstance(node, cst.Raise) or isinstance(node.value, cst.Call):
        yield cst.Pass()


def negated_condition(node: cst.If) -> Iterator[cst.If]:
    """Yield ``not`` before a condition that no operator of mutmut changes."""
    if isinstance(node.test, (cst.Name, cst.Attribute, cst.Call)):
        yield node.with_changes(test=cst.UnaryOperation(cst.Not(), node.test))


def add_operators() -> None:
    """Add the operators of this file to those of mutmut."""
    assert isinstance(mutation_operators, list)
    mutation_operators.extend(
        [
            (cst.Call, exchanged_bound),
            (cst.Expr, removed_statement),
            (cst.Raise, removed_statement),
            (cst.If, negated_condition),
        ]
    )


def names(files: list[str]) -> list[str]:
    """Return the names of all mutants of files."""
    return [
        get_mutant_name(Path(path), name)
        for path in files
        for name in mutate_file_contents(path, Path(path).read_text(encoding="utf-8")).mutant_names
    ]


def results() -> Iterator[dict[str, str]]:
    """Yield file, function, lines before and after, and outcome of each tested mutant."""
    for path in walk_mutatable_files():
        data = SourceFileMutationData(path=path)
        data.load()
        for name, status in data.exit_code_by_key.items():
            if status is None:
                continue
            function, owner = orig_function_and_class_names_from_key(name)
            lines = get_diff_for_mutant(name, path=path).splitlines()[3:]
            removed, added = ("\n".join(row[1:].strip() for row in lines if row[:1] == sign) for sign in "-+")
            yield {
                "path": str(path),
                "place": f"{owner}.{function}" if owner else function,
                "before": removed,
                "after": added,
                "outcome": status_by_exit_code[status],
            }


def main() -> None:
    """Run the command."""
    add_operators()
    action, target, *rest = sys.argv[1:]
    if action == "names":
        json.dump(names([target, *rest]), sys.stdout)
    else:
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
        cli(["run", "--max-children", "1", *rest], standalone_mode=False)
        Path(target).write_text(json.dumps(list(results())), encoding="utf-8")


if __name__ == "__main__":
    main()
