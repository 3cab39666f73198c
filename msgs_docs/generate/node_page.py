"""Generate the lower parts of the pages of the nodes (topics, services, parameters) and of the requirements."""

import tempfile
from pathlib import Path
from typing import Any

from msgs_docs.generate.rows import parameter_cell, table_lines, texts
from plant_sim.units import number_text
from train_ato.loop.plant import MAX_REQUESTS
from train_ato.messages.topics import Role, published_by, read_by
from train_ato.ros.graph.environment import applied, claim_domain, variables
from train_ato.scenario.formula import UNITS
from train_ato.scenario.scenario import load_scenario
from train_ato.scenario.setup import prepare
from train_ato.scenario.signals import SIGNALS

PAGE = Path("msgs_docs", "nodes.md")
REQUIREMENT_PAGE = Path("msgs_docs", "requirements.md")
MARK = "<!-- From here on made by `python -m msgs_docs.generate`; do not edit by hand. -->"
_SERVICES = {name: text.format(**MAX_REQUESTS) for name, text in texts("services").items()}
"""Meaning of every service."""
_EVERYWHERE = frozenset({"use_sim_time", "start_type_description_service"})


def page(written: Path = PAGE) -> str:
    """Return the page of the nodes: the text above the mark, and below it the generated sections."""
    return _below_mark(written, _sections())


def requirement_page(written: Path = REQUIREMENT_PAGE) -> str:
    """Return the page of the requirements: the text above the mark, and below it signals and units."""
    rows = ((f"`{one.name}`", one.unit, one.meaning, one.needs.text or "-") for one in SIGNALS.values())
    lines = ["", "## Signals", "", *table_lines(("signal", "unit", "meaning", "needs"), rows)]
    return _below_mark(written, [*lines, "", "## Units", "", ", ".join(f"`{unit}`" for unit in UNITS) + "."])


def _below_mark(written: Path, lines: list[str]) -> str:
    above, mark, _ = written.read_text(encoding="utf-8").partition(MARK)
    if not mark:
        raise ValueError(f"{written}: the line '{MARK}' is missing; put it back below the text")
    return above + MARK + "\n" + "\n".join(lines) + "\n"


def _sections() -> list[str]:
    """Return the sections of all nodes of the scenario ``demo``."""
    with tempfile.TemporaryDirectory() as scratch, claim_domain() as domain:
        folder = Path(scratch)
        with applied(variables(domain, folder / "log")):
            from train_ato.messages.codec import Wire
            from train_ato.program.errors import FirstFailure
            from train_ato.ros.graph.assembly import executor_of, make_node
            from train_ato.ros.graph.graph_result import GraphOptions
            from train_ato.ros.nodes.endpoints import ROLES, NodeEndpoints
            from train_ato.ros.standalone.discovery import answer_ready

            setup = prepare(*load_scenario("demo"))
            lines = []
            with executor_of(domain) as (context, executor):
                for role in ROLES:
                    endpoints = NodeEndpoints(role, Wire(setup.layout), context, FirstFailure())
                    executor.add_node(endpoints.node)
                    node = make_node(role, setup, endpoints, folder, GraphOptions())
                    if role not in (Role.PLANT, Role.RECORDER):
                        answer_ready(endpoints, setup.fingerprint())
                    lines += _section(role, endpoints.node)
                    if role is Role.RECORDER:
                        node.close(None)
            return lines


def _section(role: Role, node: Any) -> list[str]:
    topics = {"Publishes": published_by(role), "Reads": read_by(role)}
    lines = ["", f"## `{role.value}`", ""]
    for verb, found in topics.items():
        names = ", ".join(f"`{topic.name}`" for topic in found)
        if role is Role.RECORDER and verb == "Reads":
            names = "every topic of the table except `train/report` and `recorder/progress`"
        lines += [f"{verb}: {names or 'nothing'}.", ""]
    services = {service.srv_name: service.srv_type for service in node.services if _own(node, service)}
    if services:
        types = {name: f"`{kind.__module__.split('.')[0]}/srv/{kind.__name__}`" for name, kind in services.items()}
        rows = [(f"`{name}`", types[name], _SERVICES[name.rpartition("/")[2]]) for name in sorted(types)]
        lines += [*table_lines(("service", "type", "meaning"), rows), ""]
    parameters = [name for name in node.get_parameters_by_prefix("") if name not in _EVERYWHERE]
    if parameters:
        heads = ("parameter", "value in `demo`", "range", "meaning")
        lines += table_lines(heads, (_row(node, name) for name in parameters))
    else:
        lines += ["No parameters."]
    return lines


def _own(node: Any, service: Any) -> bool:
    """Return true for a service that is not common to all rclpy nodes, nor of a package that may be absent."""
    common = "parameter" in service.srv_name or service.srv_name.endswith("get_type_description")
    return not common and not service.srv_type.__module__.startswith("simulation_interfaces")


def _row(node: Any, name: str) -> tuple[str, ...]:
    """Return the cells of a parameter from its descriptor."""
    descriptor, value = node.describe_parameter(name), node.get_parameter(name).value
    ranges = [*descriptor.floating_point_range, *descriptor.integer_range]
    allowed = (
        f"{number_text(ranges[0].from_value)} ... {number_text(ranges[0].to_value)}"
        if ranges
        else descriptor.additional_constraints
    )
    fixed = " (at the start only)" if descriptor.read_only else ""
    return f"`{name}`", parameter_cell(value), allowed or "-", f"{descriptor.description}{fixed}"
