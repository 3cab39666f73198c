"""Record the golden run again; it is changed only in this way.

    python test/golden/make.py

The differences from the stored run are printed, then the new run replaces it.  The commit message gives the reason.
"""

import shutil
import sys
import tempfile
from pathlib import Path

from train_ato.log.difference import compare_logs
from train_ato.log.run_folder import RunFolder
from train_ato.loop.engine import run_engine
from train_ato.messages.codec import Wire
from train_ato.scenario.scenario import load_scenario
from train_ato.scenario.setup import RunSetup, prepare

HERE = Path(__file__).resolve().parent
SCENARIO = HERE / "short_train.yaml"
GOLDEN = HERE / "short_train"
LARGEST = 300_000
"""Size of log and metadata that the repository may carry [bytes]."""


def record(setup: RunSetup, folder: Path) -> None:
    """Drive the scenario in the engine and leave log and metadata in a new folder."""
    with RunFolder.make(folder, "golden").sink(setup, compression="small") as sink:
        outcome = run_engine(setup, sink=sink)
    if outcome.failure:
        raise SystemExit(outcome.failure)


def main() -> int:
    """Record, compare, replace."""
    setup = prepare(*load_scenario(str(SCENARIO)))
    with tempfile.TemporaryDirectory() as scratch:
        new = Path(scratch) / "new"
        record(setup, new)
        size = sum(path.stat().st_size for path in new.iterdir())
        if size > LARGEST:
            raise SystemExit(f"the run has {size} bytes, at most {LARGEST}; shorten {SCENARIO.name}")
        if GOLDEN.exists():
            found = compare_logs(GOLDEN, new, Wire(setup.layout))
            print(f"{found.differing} of {found.messages} messages differ; first: {found.first}")
            shutil.rmtree(GOLDEN)
        shutil.copytree(new, GOLDEN)
    print(f"{GOLDEN}: {size} bytes")
    return 0


if __name__ == "__main__":
    sys.exit(main())
