"""``train-ato verify``: run a recorded scenario again and compare every message.

Options::

    run RUN       run folder or single log
    --relative R  tolerance relative to the largest value of a field (default: 0, bit for bit)
"""

import argparse
import dataclasses
import sys

from train_ato.cli.screen import print_json
from train_ato.program.arguments import Options
from train_ato.program.errors import RunFailed

OPTIONS: Options = {"--relative": {"type": float, "default": 0.0}}


def execute(options: argparse.Namespace) -> None:
    """Repeat the run in the engine and compare both logs field by field."""
    from train_ato.api.verifying import difference_note, verify

    if not 0 <= options.relative < 1:
        raise ValueError(f"--relative {options.relative}: out of range; give 0 to below 1, for example 1e-6")
    found = verify(options.run, options.relative)
    if options.json:
        print_json({"run": str(options.run), "equal": found.equal, **dataclasses.asdict(found)})
    elif found.equal:
        how = f"up to {options.relative:g} of its field" if options.relative else "bit for bit"
        sys.stdout.write(f"{options.run}: {found.messages} messages are equal, {how}\n")
    if not found.equal:
        raise RunFailed(
            f"{options.run}: {found.differing} of {found.messages} messages differ; first: {found.first}"
            f"{difference_note(options.run)}"
        )
