"""Marks of the cases by their measured cost: quick cases have none, the others ``graph`` or ``campaign``.

``case_costs.txt`` has the processor time of every case above a limit, with its child processes, as
``pytest --write-costs`` measures it.  A ``graph`` case starts processes, browsers or DDS participants, a ``campaign``
case computes.  Both have the mark ``slow`` too.  A case that the file calls ``quick`` has none: it is the only guard of
its part of the program.  Marks set by hand in the file stay, also those of a cheaper case beside equal ones that are
quick.  CI runs one share of the campaign.
"""

import os
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import pytest

FILE = Path(__file__).with_name("case_costs.txt")
LIMIT_S = 1.0
"""Processor time above which a case has a mark [s]."""
KEPT_S = 0.2
"""Processor time above which a row of the file stays: of a grid of equal cases it leaves some to the campaign [s]."""
LISTED = 30
"""Number of cases in the list of the slowest."""
COST = "processor time"
CAMPAIGN = pytest.mark.campaign
BEGIN = pytest.StashKey[tuple[float, float]]()


def stored_costs() -> dict[str, tuple[float, str]]:
    """Return processor time [s] and mark of the cases above the limit."""
    lines = FILE.read_text(encoding="utf-8").splitlines() if FILE.exists() else []
    rows = (line.split(maxsplit=2) for line in lines)
    return {case: (float(cost), mark) for cost, mark, case in rows}


def case_name(nodeid: str) -> str:
    """Return the identification of a case, without the folder of its file."""
    return nodeid.removeprefix(f"{FILE.parent.name}/")


def sampled(values: Iterable[Any], every: int) -> list[Any]:
    """Return the cases of a parameter; all but every n-th one belong to the campaign."""
    return [
        value if index % every == 0 else pytest.param(*value if isinstance(value, tuple) else (value,), marks=CAMPAIGN)
        for index, value in enumerate(values)
    ]


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("costs")
    group.addoption("--campaign", metavar="K/N", help="of the campaign, only share K of N (K is taken modulo N)")
    group.addoption("--write-costs", action="store_true", help="write the measured costs into case_costs.txt")


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Mark the cases; leave out those of the campaign that are not in the share."""
    costs = stored_costs()
    for item in items:
        mark = costs.get(case_name(item.nodeid), (0.0, ""))[1]
        if item.get_closest_marker("slow") is not None and item.get_closest_marker("graph") is None:
            mark = mark or "campaign"
        if mark and mark != "quick":
            item.add_marker(mark)
        if item.get_closest_marker("graph") is not None or item.get_closest_marker("campaign") is not None:
            item.add_marker("slow")
    if config.getoption("campaign"):
        number, shares = map(int, config.getoption("campaign").split("/"))
        campaign = [item for item in items if item.get_closest_marker("campaign") is not None]
        campaign.sort(key=lambda item: (-costs.get(case_name(item.nodeid), (0.0, ""))[0], item.nodeid))
        left_out = {item for index, item in enumerate(campaign) if index % shares != number % shares}
        items[:] = [item for item in items if item not in left_out]
        config.hook.pytest_deselected(items=list(left_out))
    # cases of minutes have a time limit of their own: begun last, one worker would run them alone at the end
    items.sort(key=lambda item: item.get_closest_marker("timeout") is None)


def _times() -> tuple[float, float]:
    """Return the processor time of this process and of its ended children [s]."""
    now = os.times()
    return now.user + now.system, now.children_user + now.children_system


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    item.stash[BEGIN] = _times()
    return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo[None]) -> Iterator[None]:
    """Add own and children's processor time [s] of a case to the report of its last phase."""
    report = yield
    if call.when == "teardown":
        report.user_properties.append(
            (COST, [now - then for now, then in zip(_times(), item.stash[BEGIN], strict=True)])
        )
    return report


class Measured:
    """Costs of the cases of this session, from the reports of its workers: own and children's time [s]."""

    def __init__(self) -> None:
        self.costs: dict[str, tuple[float, float]] = {}

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        for name, value in report.user_properties if report.when == "teardown" else ():
            if name == COST:
                self.costs[case_name(report.nodeid)] = (value[0], value[1])

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
        totals = sorted(((sum(cost), case) for case, cost in self.costs.items()), reverse=True)
        if config.getoption("write_costs"):
            self.write()
        if config.getoption("write_costs") or os.environ.get("CI"):
            terminalreporter.section(f"processor time: {sum(cost for cost, _ in totals):.0f} s; slowest {LISTED} cases")
            for cost, case in totals[:LISTED]:
                terminalreporter.line(f"{cost:8.1f} s  {case}")

    def write(self) -> None:
        """Write the measured cases above the limit; keep rows of cases that were not run, and marks set by hand."""
        stored = stored_costs()
        rows = {case: row for case, row in stored.items() if case not in self.costs and _exists(case)}
        for case, (own, children) in self.costs.items():
            if own + children > (KEPT_S if case in stored else LIMIT_S):
                mark = "graph" if children > own else "campaign"
                rows[case] = (own + children, stored.get(case, (0.0, mark))[1])
        lines = (f"{cost:6.1f} {mark:8s} {case}\n" for case, (cost, mark) in sorted(rows.items()))
        FILE.write_text("".join(lines), encoding="utf-8")


def _exists(case: str) -> bool:
    file, _, name = case.partition("::")
    path = FILE.with_name(file)
    return path.is_file() and f"def {name.partition('[')[0]}(" in path.read_text(encoding="utf-8")


def pytest_configure(config: pytest.Config) -> None:
    if not hasattr(config, "workerinput"):
        config.pluginmanager.register(Measured())
