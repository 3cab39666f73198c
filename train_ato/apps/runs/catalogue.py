"""Names of laws and scenarios with their descriptions."""

from __future__ import annotations

from train_ato.control.registry import LAWS
from train_ato.scenario.scenario import raw_scenario, shipped_scenarios


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
