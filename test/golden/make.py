"""Record the golden run again: the only way in which it is changed.

    python test/golden/make.py

Says how the new run differs from the one that is kept, and puts it in its place.  Say in the commit why it changed.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
from pathlib import Path

from train_ato.engine import run_engine
from train_ato.record.difference import compare
from train_ato.run_folder import RunFolder
from train_ato.run_setup import RunSetup, prepare
from train_ato.scenario import load
from train_ato.wire import Wire

HERE = Path(__file__).resolve().parent
SCENARIO = HERE / "short_train.yaml"
GOLDEN = HERE / "short_train"
LARGEST = 300_000
"""Size of log and metadata that the repository may carry [bytes]."""


def record(setup: RunSetup, folder: Path) -> None:
    """Drive the scenario in the engine and leave log and metadata in a new folder."""
    with RunFolder.make(folder, "golden").sink(setup) as sink:
        outcome = run_engine(setup, sink=sink)
    if outcome.failure:
        raise SystemExit(outcome.failure)


def main() -> int:
    """Record, compare, replace."""
    setup = prepare(*load(str(SCENARIO)))
    with tempfile.TemporaryDirectory() as scratch:
        new = Path(scratch) / "new"
        record(setup, new)
        size = sum(path.stat().st_size for path in new.iterdir())
        if size > LARGEST:
            raise SystemExit(f"the run has {size} bytes, at most {LARGEST}; shorten {SCENARIO.name}")
        if GOLDEN.exists():
            found = compare(GOLDEN, new, Wire(setup.shape))
            print(f"{found.differing} of {found.messages} messages differ; first: {found.first}")
            shutil.rmtree(GOLDEN)
        shutil.copytree(new, GOLDEN)
    print(f"{GOLDEN}: {size} bytes")
    return 0


if __name__ == "__main__":
    sys.exit(main())
