"""Documentation of the nodes: topics from the table, services and parameters asked of the nodes themselves.

``python -m train_ato.node_docs`` writes the lower part of ``msgs_docs/nodes.md`` again; a test fails when it is older
than the nodes.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

from train_ato.graph.environment import applied, claim_domain, variables
from train_ato.run_setup import prepare
from train_ato.scenario import load
from train_ato.topics import Role, published_by, read_by

PAGE = Path("msgs_docs", "nodes.md")
"""Where it is written, below the top of the repository, where the command is started."""
MARK = "<!-- From here on made by `python -m train_ato.node_docs`; do not edit by hand. -->"
_EVERYWHERE = frozenset({"use_sim_time", "start_type_description_service"})


def page(written: Path = PAGE) -> str:
    """Return the page: what stands above the mark, and below it what the nodes say of themselves."""
    above, mark, _ = written.read_text(encoding="utf-8").partition(MARK)
    if not mark:
        raise ValueError(f"{written}: the line '{MARK}' is missing; put it back below the text")
    return above + MARK + "\n" + "\n".join(_sections()) + "\n"


def _sections() -> list[str]:
    """Make every node of the scenario ``demo`` and describe it."""
    with tempfile.TemporaryDirectory() as scratch, claim_domain() as domain:
        folder = Path(scratch)
        with applied(variables(domain, folder / "log")):
            from train_ato.failure import Watch
            from train_ato.graph.assembly import executor_of, make_node
            from train_ato.nodes.meeting import answer_ready
            from train_ato.nodes.shell import ROLES, Shell
            from train_ato.wire import Wire

            setup = prepare(*load("demo"))
            lines = []
            with executor_of(domain) as (context, executor):
                for role in ROLES:
                    shell = Shell(role, Wire(setup.shape), context, Watch())
                    executor.add_node(shell.node)
                    node = make_node(role, setup, shell, folder, None, 10.0)
                    if role not in (Role.PLANT, Role.RECORDER):
                        answer_ready(shell)
                    lines += _section(role, shell.node)
                    if role is Role.RECORDER:
                        node.close(None)
            return lines


def _section(role: Role, node: Any) -> list[str]:
    topics = {"Publishes": published_by(role), "Reads": read_by(role)}
    lines = ["", f"## `{role.value}`", ""]
    for verb, found in topics.items():
        names = ", ".join(f"`{topic.name}`" for topic in found)
        if role is Role.RECORDER and verb == "Reads":
            names = "every topic of the table but `record/acknowledged`"
        lines += [f"{verb}: {names or 'nothing'}.", ""]
    services = [(service.srv_name, service.srv_type) for service in node.services if _own(node, service)]
    if services:
        lines += ["| service | type |", "|---|---|"]
        lines += [f"| `{name}` | `{_type_name(kind)}` |" for name, kind in sorted(services)]
        lines += [""]
    parameters = [name for name in node.get_parameters_by_prefix("") if name not in _EVERYWHERE]
    if parameters:
        lines += ["| parameter | value in `demo` | range | meaning |", "|---|---|---|---|"]
        lines += [_row(node, name) for name in parameters]
    else:
        lines += ["No parameters."]
    return lines


def _own(node: Any, service: Any) -> bool:
    """Tell whether a service is one of ours and not one that every rclpy node has."""
    return "parameter" not in service.srv_name and not service.srv_name.endswith("get_type_description")


def _type_name(kind: Any) -> str:
    return f"{kind.__module__.split('.')[0]}/srv/{kind.__name__}"


def _row(node: Any, name: str) -> str:
    """Return the row of a parameter, from its descriptor."""
    descriptor, value = node.describe_parameter(name), node.get_parameter(name).value
    ranges = [*descriptor.floating_point_range, *descriptor.integer_range]
    allowed = f"{ranges[0].from_value:g} ... {ranges[0].to_value:g}" if ranges else descriptor.additional_constraints
    fixed = " (at the start only)" if descriptor.read_only else ""
    meaning = descriptor.description.replace("|", "\\|")
    return f"| `{name}` | {_shown(value)} | {allowed or '-'} | {meaning}{fixed} |"


def _shown(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:g}" if isinstance(value, (int, float)) else str(value) or "-"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
