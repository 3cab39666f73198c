"""Compare ``summary.json`` of every shipped scenario and variant between two versions of the code, to the last digit.

    git worktree add /tmp/before REVISION
    python test/golden/summaries.py record /tmp/before before.json
    python test/golden/summaries.py record . after.json
    python test/golden/summaries.py compare before.json after.json

``record SOURCE FILE [--only SCENARIO ...]`` drives every scenario with ``train-ato run --engine`` of the source tree
SOURCE, two runs at a time, and writes the summaries. ``compare`` prints the differences and exits with status 1 if
there are any; keys that measure wall time are left out. A renamed key is compared under the name of the second file
(``RENAMED``).
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

WALL = ("wall_s", "real_time_factor", "step_time_us_median", "step_time_us_p99", "version", "started")
RENAMED = {"way": "mode"}


def run_cli(source: Path, *words: str) -> subprocess.CompletedProcess[str]:
    """Run the command line of a source tree, from a folder outside of every tree."""
    environment = {**os.environ, "PYTHONPATH": str(source.resolve()), "PYTHONSAFEPATH": "1"}
    command = [sys.executable, "-m", "train_ato", *words]
    return subprocess.run(command, env=environment, capture_output=True, text=True, cwd=tempfile.gettempdir())


def summary_of(source: Path, scenario: str) -> dict[str, Any]:
    """Drive one scenario in the engine and return its summary, or the error line of a refused or failed run."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / "run"
        done = run_cli(source, "run", scenario, "--engine", "--out", str(folder))
        summary = folder / "summary.json"
        if not summary.is_file():
            return {"exit_status": done.returncode, "stderr": done.stderr.strip().splitlines()[-1:]}
        return dict(json.loads(summary.read_text()))


def record(source: Path, file: Path, only: list[str]) -> None:
    """Write the summaries of all scenarios of a source tree, or only of those named."""
    scenarios = only or list(json.loads(run_cli(source, "list", "--json").stdout)["scenarios"])
    with ThreadPoolExecutor(2) as pool:
        found = dict(zip(scenarios, pool.map(lambda name: summary_of(source, name), scenarios), strict=True))
    file.write_text(json.dumps(found, indent=1, sort_keys=True) + "\n")
    print(f"{len(found)} summaries written to {file}")


def differences(before: dict[str, Any], after: dict[str, Any]) -> list[str]:
    """Return one line for every value of the first file that the second does not repeat to the last digit."""
    lines = []
    for scenario, old in before.items():
        new = after.get(scenario)
        if new is None:
            lines.append(f"{scenario}: missing in the second file")
            continue
        for key, value in old.items():
            name = key if key in new else RENAMED.get(key, key)
            if key not in WALL and new.get(name, "(no such key)") != value:
                lines.append(f"{scenario}: {name}: {value!r} became {new.get(name, '(no such key)')!r}")
    return lines


def main() -> int:
    """Run one of the two commands."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    writer = commands.add_parser("record")
    writer.add_argument("source", type=Path)
    writer.add_argument("file", type=Path)
    writer.add_argument("--only", nargs="+", default=[], metavar="SCENARIO", help="drive these instead of all")
    reader = commands.add_parser("compare")
    reader.add_argument("before", type=Path)
    reader.add_argument("after", type=Path)
    given = parser.parse_args()
    if given.command == "record":
        record(given.source, given.file, given.only)
        return 0
    found = differences(json.loads(given.before.read_text()), json.loads(given.after.read_text()))
    print("\n".join(found) or "all summaries are equal to the last digit")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
