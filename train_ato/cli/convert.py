"""``train-ato convert IN OUT``: write a line or a train of a foreign file in the own format."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

OWN, TTOBENCH = (".yaml", ".yml"), ".json"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of ``convert``."""
    from plant_sim.formats.not_read import LINE_FORMATS, TRAIN_FORMATS

    parser.add_argument(
        "source",
        metavar="IN",
        help=f"line ({LINE_FORMATS}), train ({TRAIN_FORMATS}) or shipped name; a path through a network of tracks is "
        "FILE:FROM..TO, one of several paths or trains FILE:NAME, a line against its direction LINE:reverse",
    )
    parser.add_argument(
        "target", type=Path, metavar="OUT", help="new file: .yaml in the own format, or a line as TTOBench .json"
    )


def execute(options: argparse.Namespace) -> int:
    """Write the file; print the keys that it does not carry on stderr."""
    result = _converted(options.source, options.target)
    for key in result["left_out"]:
        sys.stderr.write(f"not carried: {options.source}: {key}\n")
    if options.json:
        from train_ato.cli.screen import print_json

        print_json(result)
        return 0
    sys.stdout.write(f"{result['file']}: {result['kind']} '{result['name']}', read as {result['format']}\n")
    return 0


def _converted(source: str, target: Path) -> dict[str, Any]:
    """Write the file and return its facts.

    Raises
    ------
    ValueError
        One line: file, key, value, problem; remedy.
    """
    from plant_sim.formats.reading import holds_train
    from plant_sim.formats.writing import own_yaml, ttobench_json
    from plant_sim.library import consist_names, line_names, named_line, named_train, split_name
    from train_ato.arguments import check_new_file

    check_new_file(target, (*OWN, TTOBENCH), "OUT")
    stem = split_name(source)[0]
    shipped = (*consist_names(), *line_names())
    if stem not in shipped and not Path(stem).is_file():
        raise ValueError(f"IN {source}: neither a file nor a shipped name; give a line or train file")
    if stem in consist_names() or (stem not in shipped and holds_train(Path(stem))):
        if target.suffix.lower() == TTOBENCH:
            raise ValueError(f"OUT {target}: a train is written in the own format only; end it in .yaml")
        found = named_train(source)
        text, name, left_out = own_yaml(found.consist), found.consist.name, found.left_out
        kind, form = "train", found.format
    else:
        read = named_line(source)
        kind, form, name = "line", read.format, read.line.name
        text, lost = ttobench_json(read.line) if target.suffix.lower() == TTOBENCH else (own_yaml(read.line), ())
        left_out = (*read.left_out, *lost)
    _write(target, text)
    return {"kind": kind, "name": name, "format": form, "file": str(target), "left_out": list(left_out)}


def _write(target: Path, text: str) -> None:
    """Write a whole file, or none."""
    from train_ato.log.whole_file import write_whole

    try:
        write_whole(target, text)
    except OSError as error:
        raise ValueError(f"OUT {target}: cannot be written ({error.strerror}); choose another place") from None
