"""``train-ato list [NAME | FILE]``: all names with one line each, or the details of one name or file.

Options::

    name NAME | FILE  print details of this name, or of a scenario, following, consist or line file of any format
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from plant_sim.input_error import close_match
from plant_sim.units import number_text
from train_ato.cli.screen import print_json, print_names
from train_ato.program.arguments import Options

if TYPE_CHECKING:
    from plant_sim.consist import Consist
    from plant_sim.line import Line
    from train_ato.control.contract import Parameter
    from train_ato.control.registry import Registry
    from train_ato.scenario.scenario import Scenario


Facts = dict[str, str]
GRADES = (0.0, 0.002, 0.005, 0.010)
"""Grades for the balancing speeds of a train."""
DEAD_TIMES = (0.5, 1.0, 2.0)
"""Sums of delay and lag for the bandwidths of a train [s]."""


def details(name: str) -> dict[str, Facts]:
    """Return the details of a name by kind, or of a file; one name may be an observer and a compensation."""
    from plant_sim.library import consist_names, line_names, load_consist, load_line, split_name
    from train_ato.control.registry import REGISTRIES
    from train_ato.scenario.following import find_following
    from train_ato.scenario.scenario_files import shipped_scenarios

    if (trains := find_following(name)) is not None:
        return {"following": _following(trains)}
    path = Path(split_name(name)[0])
    if path.suffix in (".yaml", ".yml"):
        return _file(name)
    if path.is_file():
        return _line_or_train(name, path)
    found: dict[str, Facts] = {}
    if split_name(name)[0] in shipped_scenarios():
        found["scenario"] = _scenario(name)
    for kind, registry in REGISTRIES.items():
        if name in registry.names():
            found[kind] = _block(registry, name)
    if name in consist_names():
        found["consist"] = _consist(load_consist(name))
    if split_name(name)[0] in line_names():
        found["line"] = _line(load_line(name))
    return found


def _file(name: str) -> dict[str, Facts]:
    """Return the details of a scenario, consist or line file, by its schema or its content."""
    from plant_sim.formats.reading import kinds_of
    from plant_sim.library import read_yaml, split_name

    path = Path(split_name(name)[0])
    data = read_yaml(path)
    schema = str(data.get("schema", "")) if isinstance(data, dict) else ""
    kind = schema.removeprefix("train_ato/").partition("/")[0]
    if kind in ("consist", "line") or kinds_of(data):
        return _line_or_train(name, path)
    if kind != "scenario" and not (isinstance(data, dict) and "base" in data):
        known = ", ".join(f"train_ato/{name}/1" for name in ("scenario", "consist", "line", "following"))
        raise ValueError(f"{path}: schema: {schema!r}: not known; write one of {known}")
    return {"scenario": _scenario(name)}


def _line_or_train(name: str, path: Path) -> dict[str, Facts]:
    """Return the details of a file in any format, with the selection or the direction in its name."""
    from plant_sim.formats.reading import holds_train
    from plant_sim.library import load_consist, load_line

    return {"consist": _consist(load_consist(name))} if holds_train(path) else {"line": _line(load_line(name))}


def _scenario(name: str) -> Facts:
    from plant_sim.library import split_name
    from train_ato.scenario.scenario import expectation_of, load_scenario
    from train_ato.scenario.scenario_files import find, variants_of

    scenario, path = load_scenario(name)
    stem = split_name(name)[0]
    plant = scenario.plant
    facts = {
        "summary": scenario.summary,
        "file": str(path),
        "duration": f"{number_text(scenario.duration)} s in ticks of {scenario.tick:g} s, plant step "
        f"{scenario.step * 1e3:g} ms",
        "train": plant.consist if isinstance(plant.consist, str) else plant.consist.name,
        "line": plant.line if isinstance(plant.line, str) else plant.line.name,
        "law": scenario.law,
        "observer": scenario.observer,
        "compensation": scenario.compensation,
    }
    if expected := expectation_of(name):
        facts["expected verdict"] = expected.text
    facts |= _of_run(scenario, path)
    return facts | {f"{stem}:{variant}": summary for variant, summary in variants_of(find(stem)[0]).items()}


def _following(path: Path) -> Facts:
    from train_ato.scenario.following import load_following

    spec = load_following(path).spec
    facts = {"summary": spec.summary, "file": str(path)}
    for number, train in enumerate(spec.trains):
        facts[train.name] = train.scenario + (f", behind {spec.trains[number - 1].name}" if number else "")
    criteria = spec.criteria.model_dump(exclude_none=True)
    return facts | {"criteria": ", ".join(f"{key} {value:g}" for key, value in criteria.items()), "source": spec.source}


def _of_run(scenario: Scenario, path: Path) -> Facts:
    """Return the names in the messages of a run, and the gains that every law would take with their source."""
    from train_ato.control.registry import LAWS
    from train_ato.messages.topics import BY_NAME
    from train_ato.scenario.setup import prepare

    try:
        setup = prepare(scenario, path)
    except ValueError:
        return {}
    found = {
        f"names of {topic}": ", ".join(BY_NAME[topic].names(setup.layout))
        for topic in ("train/measurement", "ato/command")
    }
    for law in LAWS.loadable():
        gains = setup.gains(law)
        if gains.source:
            shown = {key: number_text(x, 3) if isinstance(x, float) else str(x) for key, x in gains.values.items()}
            values = ", ".join(f"{key} {text}" for key, text in shown.items() if key != "gains")
            found[f"gains of {law}"] = f"{gains.source}, {gains.reason}{': ' if values else ''}{values}"
    return found


def _block(registry: Registry, name: str) -> Facts:
    from train_ato.control.gains import fitted_trains, has_gains
    from train_ato.control.registry import LAWS

    facts = {"summary": registry.summary(name)} | {p.name: _parameter(p) for p in registry.parameters(name)}
    if registry is LAWS and has_gains(LAWS.get(name)):
        facts["trains"] = f"fitted: {', '.join(fitted_trains(name))}; `train-ato list SCENARIO` has the gains of a run"
    return facts


def _parameter(parameter: Parameter) -> str:
    """Return default, unit, range or choices, and meaning as one line."""
    default = parameter.default
    if isinstance(default, bool):
        value = "true or false"
    elif isinstance(default, str):
        value = ", ".join(parameter.choices)
    else:
        value = f"{number_text(parameter.low)} ... {number_text(parameter.high)}"
    shown = str(default).lower() if isinstance(default, bool) else default
    unit = "" if parameter.unit in ("", "1") else f" {parameter.unit}"
    return f"{shown}{unit} ({value}): {parameter.meaning}"


def _consist(consist: Consist) -> Facts:
    from train_ato.profile.planner.train_tables import balancing_speed, holding_force, steepest_start

    vehicles, units = len(consist.vehicles), len(consist.power_units)
    facts = {
        "summary": consist.summary,
        "vehicles": f"{vehicles}, {units} of them driven; {number_text(consist.mass / 1e3)} t, {consist.length:g} m",
        "air brake": "yes" if consist.air_brake is not None else "no",
    }
    moving: dict[str, Callable[[], str]] = {
        "balancing speed": lambda: ", ".join(
            f"{3.6 * balancing_speed(consist, grade):.0f} km/h at {1e3 * grade:g} per mille" for grade in GRADES
        ),
        "steepest starting grade": lambda: f"{1e3 * steepest_start(consist):.1f} per mille",
        "at 60 km/h": lambda: (
            f"{holding_force(consist, 60 / 3.6, 0.0) / 1e3:.0f} kN keep the speed on level track, "
            f"{holding_force(consist, 60 / 3.6, -0.010) / 1e3:.0f} kN on a descent of 10 per mille"
        ),
        "law mpc": lambda: "; ".join(f"delay and lag {dead:g} s: {_bandwidth(consist, dead)}" for dead in DEAD_TIMES),
    }
    if units:
        facts |= {key: text() for key, text in moving.items()}
    return facts | {"source": consist.source}


def _bandwidth(consist: Consist, dead: float) -> str:
    """Return the default bandwidth of `mpc` for a sum of delay and lag [s], and its conditions, as text."""
    import numpy as np

    from plant_sim.library import load_line
    from train_ato.control.algorithms.coupler_modes import bandwidth_text
    from train_ato.control.train_model import TrainModel

    delays = np.full(len(consist.power_units), dead)
    return bandwidth_text(TrainModel(consist, load_line("level"), delays, delays, 0.0, dead))


def _km(line: Line, place: float) -> str:
    """Return the kilometre of a place [m], by the posts of a line with a chainage."""
    return line.post_at(place) if line.chainage else number_text(place / 1e3, 9)


def _line(line: Line) -> Facts:
    from plant_sim.track import Track

    track = Track(line)
    height = track.elevation(track.breaks)
    facts = {
        "summary": line.summary,
        "extent": f"from km {_km(line, line.begin)} to km {_km(line, line.end)}",
        "grades": f"{1e3 * track.grade.min():g} ... {1e3 * track.grade.max():g} per mille",
        "height": f"from {height.min():.1f} to {height.max():.1f} m above its begin, {height[-1]:.1f} m at its end",
        "curves": str(len(line.curves)),
    }
    if line.curves:
        facts["curves"] += f", radius from {min(curve.radius for curve in line.curves):g} m"
    if line.speed_limits:
        limits = [3.6 * limit.speed for limit in line.speed_limits]
        facts["speed limits"] = f"{number_text(min(limits))} ... {number_text(max(limits))} km/h"
    for key in ("temporary_restrictions", "neutral_sections", "power_limits", "adhesion"):
        if sections := getattr(line, key):
            places = ", ".join(f"km {_km(line, entry.begin)} to {_km(line, entry.end)}" for entry in sections)
            facts[key.replace("_", " ")] = places
    if line.stops:
        facts["stops"] = ", ".join(f"{stop.name} km {_km(line, stop.at)}".strip() for stop in line.stops)
    return facts | {"source": line.source}


OPTIONS: Options = {"name": {"nargs": "?"}}


def catalogue() -> dict[str, dict[str, str]]:
    """Return the names of every kind with their one-line summaries."""
    from train_ato.api import catalogue as shipped
    from train_ato.scenario.following import load_following
    from train_ato.scenario.scenario_files import shipped_following, shipped_scenarios, variants_of

    scenarios: dict[str, str] = {}
    paths = shipped_scenarios()
    for name, summary in shipped.scenarios().items():
        scenarios |= {name: summary}
        scenarios |= {f"{name}:{variant}": text for variant, text in variants_of(paths[name]).items()}
    return {
        "scenarios": scenarios,
        "following": {name: load_following(path).spec.summary for name, path in shipped_following().items()},
        "laws": shipped.laws(),
        "observers": shipped.observers(),
        "compensations": shipped.compensations(),
        "consists": shipped.trains(),
        "lines": shipped.lines(),
    }


def execute(options: argparse.Namespace) -> None:
    """Print the catalogue, or the details of one name."""
    found = catalogue() if options.name is None else _details_of(options.name)
    from train_ato.scenario.scenario import expectation_of

    stated = {name: expectation_of(name) for name in found.get("scenarios", ())}
    expected = {name: "" if verdict is None else verdict.text for name, verdict in stated.items()}
    if options.json:
        print_json({**found, "expected": expected} if expected else found)
        return
    for kind, entries in found.items():
        if kind == "scenarios":
            rows = [(name, expected[name].partition(" ")[0], summary) for name, summary in entries.items()]
            print_names("scenarios, with expected verdict (`train-ato list NAME` has its cause)", rows)
        else:
            print_names("following trains, for `train-ato run`" if kind == "following" else kind, entries.items())


def _details_of(name: str) -> dict[str, dict[str, str]]:
    found = details(name)
    if not found:
        from plant_sim.library import consist_names, line_names
        from train_ato.control.registry import REGISTRIES
        from train_ato.scenario.scenario_files import shipped_following, shipped_scenarios

        components = (name for registry in REGISTRIES.values() for name in registry.names())
        known = {*shipped_scenarios(), *shipped_following(), *components, *consist_names(), *line_names()}
        raise ValueError(f"unknown name '{name}'{close_match(name, known)}; see `train-ato list`")
    return {f"{kind} {name}": facts for kind, facts in found.items()}
