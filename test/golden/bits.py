"""Hash the arrays of many runs; a change of one bit in one of them is a changed line of ``bits.txt``.

    python test/golden/bits.py                 # compare all runs with bits.txt: three minutes of processor time
    python test/golden/bits.py --write         # replace bits.txt; the commit message gives the reason
    python test/golden/bits.py 'grid demo smc'  # only the runs whose names contain the text

The runs: every shipped scenario and variant, every fault of the fault table, every law with every observer and
compensation with and without a supervisor, and the cases of the tests of compiled ticks. The hash of a run covers
times and values of all its topics. Short runs are driven in Python and in compiled ticks.
"""

import argparse
import hashlib
import sys
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parent), str(HERE.parents[1])]

from law_trains import printed  # noqa: E402
from test_compiled_spans import CASES, COMPONENTS, SUPERVISED  # noqa: E402

from msgs_docs.generate.fault_page import BASES, ROWS  # noqa: E402
from train_ato.api.scenario_choice import choose_scenario  # noqa: E402
from train_ato.control.registry import COMPENSATIONS, LAWS, OBSERVERS  # noqa: E402
from train_ato.judge.result import RunResult  # noqa: E402
from train_ato.log.versions import versions  # noqa: E402
from train_ato.loop.engine import run_engine  # noqa: E402
from train_ato.scenario.scenario import load_scenario  # noqa: E402
from train_ato.scenario.scenario_files import scenario_names  # noqa: E402
from train_ato.scenario.setup import RunSetup, prepare  # noqa: E402

BITS = HERE / "bits.txt"
GRID = {"demo": 30.0, "crh380a_gpc:short": 20.0, "freight_consensus:aligned": 0.3}
"""Scenarios of the grid with the time they are driven [s]: hauled wagons, three units, five coupled vehicles."""
WHOLE_S = 700.0
"""Longest shipped scenario that is driven whole [s]; the others are driven for this time."""
LENGTHS = {"gpc": 0.2, "mpc": 0.05}
"""Part of the time that is driven with a law that costs more."""
SHORT = 600
"""Number of ticks up to which a run is driven in Python and in compiled ticks."""
MACHINE = ("libc", "machine")
"""Versions that may change the last bits: the functions of the C library."""


@dataclass(frozen=True)
class Case:
    """A run by name.

    Attributes
    ----------
    name
        Kind, scenario and choice in words.
    scenario
        Name of the scenario.
    changes
        Values by key, or assignments; None for a shipped scenario as it is, shortened if it is long.
    """

    name: str
    scenario: str
    changes: Mapping[str, Any] | tuple[str, ...] | None

    def prepare(self) -> RunSetup:
        """Return the prepared run; a refused combination raises ``ValueError``."""
        if isinstance(self.changes, tuple):
            return prepare(*load_scenario(self.scenario, self.changes))
        changes = dict(self.changes or {})
        if self.changes is None:
            whole = load_scenario(self.scenario)[0]
            changes["duration"] = min(whole.duration, WHOLE_S) * LENGTHS.get(whole.law, 1.0)
        return choose_scenario(self.scenario).changed(changes, None).prepare()


def cases() -> Iterator[Case]:
    """Yield all cases in a fixed order."""
    for name in scenario_names():
        yield Case(f"shipped {name}", name, None)
    for row in ROWS:
        scenario, *sets = BASES[row.base]
        short = () if row.base == "metro" else ("duration=130",)
        yield Case(f"fault {row.name}", scenario, (*sets, *short, *row.sets))
    yield from _grid()
    spans = {"compiled_spans": CASES, "span_components": COMPONENTS, "supervised_spans": SUPERVISED}
    for room, cases in spans.items():
        for name, (scenario, changes) in cases.items():
            yield Case(f"{room} {name}", scenario, changes)


def _grid() -> Iterator[Case]:
    """Yield every combination without and with a supervisor, on trains in turn."""
    kinds = LAWS.names(), OBSERVERS.names(), COMPENSATIONS.names(), (False, True)
    for number, (law, observer, compensation, enabled) in enumerate(product(*kinds)):
        scenario = list(GRID)[(number + number // 7) % len(GRID)]
        changes = {
            "duration": GRID[scenario] * LENGTHS.get(law, 1.0), "law": law, "observer": observer,
            "compensation": compensation, "supervision.enabled": enabled, f"laws.{law}": printed(law),
        }  # fmt: skip
        name = f"grid {law} {observer} {compensation}{' supervised' * enabled} {scenario}"
        yield Case(name, scenario, changes)


def bits_of(result: RunResult) -> str:
    """Return a hash of times and values of all topics of a run, and of the node that failed."""
    digest = hashlib.sha256(str(result.failure).partition(":")[0].encode())
    assert result.recording is not None
    for topic, samples in sorted(result.recording.topics.items()):
        for name, values in (("time", samples.time), *sorted(samples.values.items())):
            digest.update(f"{topic} {name} {values.dtype.str} {values.shape}".encode())
            digest.update(values.tobytes())
    return digest.hexdigest()[:16]


def hashes(case: Case) -> set[str]:
    """Return the hash of a case, of short ones from Python and from compiled ticks: one if they are equal."""
    try:
        setup = case.prepare()
    except ValueError:
        return {"refused"}
    forms = (False, True) if setup.ticks <= SHORT else (True,)
    return {bits_of(run_engine(setup if form else case.prepare(), compiled=form)) for form in forms}


def stored() -> tuple[dict[str, str], dict[str, str]]:
    """Return the versions with which the hashes were made, and the hashes by the name of the case."""
    first, *lines = BITS.read_text().splitlines()
    made = dict(entry.split("=", 1) for entry in first.removeprefix("# ").split("; "))
    return made, {name: value for value, name in (line.split(" ", 1) for line in lines)}


def made_elsewhere() -> bool:
    """Return True if the hashes are those of another C library, whose functions may have other last bits."""
    return any(stored()[0][name] != versions()[name] for name in MACHINE)


def differences(chosen: Iterable[Case]) -> Iterator[str]:
    """Drive cases and yield a line for each one that has not its stored bits."""
    before = stored()[1]
    for case in chosen:
        found = " ".join(sorted(hashes(case)))
        if found != before.get(case.name):
            yield f"{case.name}: {before.get(case.name, 'new')} became {found}"


def changed(chosen: Iterable[Case], found: dict[str, str] | None = None) -> Iterator[str]:
    """Drive cases and yield a line for each with other bits than the stored ones; ``found`` takes the hashes."""
    before = stored()[1] if BITS.is_file() else {}
    for case in chosen:
        now = " ".join(sorted(hashes(case)))
        if found is not None:
            found[case.name] = now
        if now != before.get(case.name):
            yield f"{case.name}: {before.get(case.name, 'new')} became {now}"


def main() -> int:
    """Compare or write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("text", nargs="?", default="", help="part of the names of the runs")
    parser.add_argument("--write", action="store_true", help="replace the hashes of these runs")
    given = parser.parse_args()
    found: dict[str, str] = {}
    lines = 0
    for line in changed((case for case in cases() if given.text in case.name), found):
        print(line, flush=True)
        lines += 1
    print(f"{lines} of {len(found)} runs differ")
    if given.write:
        kept = {**stored()[1], **found} if given.text else found
        made = "; ".join(f"{name}={versions()[name]}" for name in MACHINE)
        BITS.write_text(f"# {made}\n" + "".join(f"{value} {name}\n" for name, value in kept.items()))
    return 1 if lines and not given.write else 0


if __name__ == "__main__":
    sys.exit(main())
