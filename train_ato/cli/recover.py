"""``train-ato recover``: restore a readable log from an incomplete or damaged one.

Options::

    file FILE  run.mcap.partial, a damaged log, or its folder
"""

import argparse
import dataclasses

from train_ato.cli.screen import print_result


def execute(options: argparse.Namespace) -> None:
    """Write the intact part of the log as a new log; the damaged file is kept beside it."""
    from train_ato.api.progress import share_bar
    from train_ato.log.bag_layout import METADATA
    from train_ato.log.recover import recover

    with share_bar(f"recovering {options.file}") as progress:
        found = recover(options.file, lambda share: progress(share, ""))
    paths = {"log": str(found.path), "kept": None if found.kept is None else str(found.kept)}
    counts = {key: value for key, value in dataclasses.asdict(found).items() if key not in ("path", "kept")}
    if found.metadata_only:
        kept = f"; previous file: {found.kept}" if found.kept else ""
        again = found.path.parent / METADATA
        text = f"{found.path} is complete, {found.messages} messages; metadata written: {again}{kept}\n"
    else:
        lost = f"; {found.lost_chunks} damaged or incomplete chunks omitted" if found.lost_chunks else ""
        text = f"{found.messages} messages recovered into {found.path}{lost}; previous file: {found.kept}\n"
    print_result(paths | counts, text, as_json=options.json)
