"""Names of everything shipped with their descriptions."""

from plant_sim.library import consist_names, line_names, load_consist, load_line
from train_ato.control.registry import COMPENSATIONS, LAWS, OBSERVERS
from train_ato.scenario.scenario import raw_scenario
from train_ato.scenario.scenario_files import shipped_scenarios


def laws() -> dict[str, str]:
    """Return the registered control laws and their descriptions.

    Examples
    --------
    >>> import train_ato as ta
    >>> "pid" in ta.laws()
    True
    """
    return {name: LAWS.summary(name) for name in LAWS.loadable()}


def scenarios() -> dict[str, str]:
    """Return the shipped scenarios and their descriptions; ``scenario(name).variants`` lists the variants.

    Examples
    --------
    >>> import train_ato as ta
    >>> "demo" in ta.scenarios()
    True
    """
    return {name: str(raw_scenario(name)[1].get("summary", "")) for name in shipped_scenarios()}


def observers() -> dict[str, str]:
    """Return the registered disturbance observers and their descriptions."""
    return {name: OBSERVERS.summary(name) for name in OBSERVERS.loadable()}


def compensations() -> dict[str, str]:
    """Return the registered delay compensations and their descriptions."""
    return {name: COMPENSATIONS.summary(name) for name in COMPENSATIONS.loadable()}


def trains() -> dict[str, str]:
    """Return the shipped trains and their descriptions."""
    return {name: load_consist(name).summary for name in consist_names()}


def lines() -> dict[str, str]:
    """Return the shipped lines and their descriptions."""
    return {name: load_line(name).summary for name in line_names()}
