"""Gains of a law for a train: fitted to a shipped train, computed from the model of the train, or as printed.

``fitted`` takes the table ``fitted_gains.yaml``, which has values or ``model``; a train that is not in it, or a longer
delay, takes ``model``, the rule of the law (``model_gains`` of its control period [s]).  ``printed`` takes the defaults
of the parameters, which are those of the paper.  A law without a paper, such as ``mpc``, has only ``model``, which is
then its default.  A parameter that is given has its given value under every choice.
"""

import functools
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from plant_sim.units import number_text
from train_ato.control.contract import choice, parameters_of
from train_ato.control.train_model import TrainModel

FITTED, MODEL, PRINTED = "fitted", "model", "printed"
GIVEN = "given"
"""Source of parameters that a scenario gives beside ``gains: printed``."""
TABLE = Path(__file__).with_name("fitted_gains.yaml")
SAME_MASS = 0.01
"""Largest relative difference of the mass of a train from that in the table."""


def model_choice() -> Any:
    """Declare the parameter ``gains`` of a law that computes its values from the model of the train by itself."""
    return choice("source of the values that are not given: computed from the model of the train", MODEL)


def gains_choice() -> Any:
    """Declare the parameter ``gains`` of a law."""
    return choice(
        "source of the values that are not given. fitted: searched for a shipped train (another train has model). "
        "model: computed from the model of the train. printed: figures of the paper",
        FITTED, MODEL, PRINTED,
    )  # fmt: skip


@dataclass(frozen=True)
class Gains:
    """Parameters of a law for a train.

    Attributes
    ----------
    values : dict
        Parameters that differ from the printed ones.
    source : str
        ``fitted``, ``model``, ``printed`` or ``given``; "" for a law without a choice of gains.
    reason : str
        Reason for the source as text; "" for a law without a choice.
    own : dict
        Values of the source in whose place others are given, by name.
    """

    values: dict[str, Any]
    source: str = ""
    reason: str = ""
    own: dict[str, Any] = field(default_factory=dict)


def has_gains(law: Any) -> bool:
    """Return True if a law has the parameter ``gains`` with the three choices."""
    return FITTED in _choices(law)


def has_rule(law: Any) -> bool:
    """Return True if a law has the parameter ``gains`` with the choice ``model``."""
    return MODEL in _choices(law)


def _choices(law: Any) -> tuple[str, ...]:
    return next((entry.choices for entry in parameters_of(law.Parameters) if entry.name == "gains"), ())


def gains_of(name: str, law: Any, given: Mapping[str, Any], model: TrainModel, period: float) -> Gains:
    """Return the parameters of a law for a train.

    Parameters
    ----------
    name, law
        Name of the law, and its class.
    given
        Parameters that are given, with the choice ``gains``; they remain.
    model
        Nominal train with delay and lag [s].
    period
        Period of the law [s].
    """
    if not has_rule(law):
        return Gains(dict(given))
    chosen = given.get("gains", FITTED if has_gains(law) else MODEL)
    base, source, reason = _base(name, law, chosen, model, period)
    standing = {**{entry.name: entry.default for entry in parameters_of(law.Parameters)}, **base}
    if source == MODEL and (note := getattr(law, "gains_note", None)) and (text := note(model, given)):
        reason += f": {text}"
    own = {key: standing.get(key) for key, value in given.items() if key != "gains" and standing.get(key) != value}
    if own:
        source = GIVEN if source == PRINTED else source
        reason += f"; {', '.join(own)} given"
    return Gains({**base, **given}, source, reason, own)


def _base(name: str, law: Any, chosen: str, model: TrainModel, period: float) -> tuple[dict[str, Any], str, str]:
    """Return the values of a choice that differ from the printed ones, their source, and its reason."""
    if chosen not in (FITTED, MODEL):
        return {}, PRINTED, "as printed in the paper"
    missing, train = "", model.consist.name
    if chosen == FITTED:
        values, missing = _fitted(name, model, period)
        if values == MODEL:
            return law.model_gains(model, period), MODEL, f"computed from the model of {train}, the best found"
        if isinstance(values, dict):
            return dict(values), FITTED, f"fitted to {train}"
        missing += "; "
    rule = getattr(law, "model_gains", None)
    if rule is None:
        return {}, PRINTED, f"{missing}as printed in the paper, without a rule"
    return rule(model, period), MODEL, f"{missing}computed from the model of {train}"


def advice(
    name: str, law: Any, gains: Gains, model: TrainModel, period: float, compensation: str, *, unstable: bool
) -> str:
    """Return a line with the remedy for gains that do not fit the train, or a delay without compensation; "" if none.

    Parameters
    ----------
    name, law
        Name of the law, and the law.
    gains
        Its parameters.
    model, period
        Nominal train, and period of the law [s].
    compensation
        Name of the delay compensation.
    unstable
        The parameters, with given ones, are unstable on the train.
    """
    found, remedies = [], []
    if gains.source == PRINTED:
        found.append("printed gains, not made for this train")
        remedies.append(
            f"--set laws.{name}.gains={MODEL}" if hasattr(law, "model_gains") else f"train-ato tune --law {name}"
        )
    elif unstable:
        names = ", ".join(gains.own)
        found.append(f"{names} given, unstable or close to it with delay, lag and couplers of this train")
        rule = law.model_gains(model, period)
        values = {key: rule[key] for key in gains.own if key in rule} or {"gains": MODEL}
        if gains.source == FITTED or not rule:
            values = gains.own
        remedies += [f"--set laws.{name}.{key}={_rounded(value)}" for key, value in values.items()]
    delay = model.longest_delay
    late = getattr(law, "uses_feedforward", True) or not getattr(law, "predicts_delay", False)
    if compensation == "none" and delay + model.lag > period and late:
        found.append(f"delay {number_text(delay)} s and lag {number_text(model.lag)} s without compensation")
        remedies.append("--compensation preview")
    return f"{name}: {', '.join(found)}; try {' '.join(remedies)}" if found else ""


def doubt(name: str, gains: Gains, outcome: str) -> str:
    """Return a line with the own values of a law whose run had another outcome than planned; "" without own values."""
    remedies = " ".join(f"--set laws.{name}.{key}={_rounded(value)}" for key, value in gains.own.items())
    return f"{name}: {', '.join(gains.own)} given, and the run {outcome}; try {remedies}" if gains.own else ""


def _rounded(value: Any) -> str:
    return number_text(value, 3) if isinstance(value, float) else str(value)


def _fitted(law: str, model: TrainModel, period: float) -> tuple[dict[str, Any] | str | None, str]:
    """Return the gains of the first entry of the table that holds, values or ``model``, or None and the reason."""
    train, tonnes = model.consist.name, model.mass / 1e3
    now = {"delay": model.longest_delay, "lag": model.lag, "period": period}
    reason = f"not fitted to {train}"
    for entry in _table():
        mass = entry["trains"].get(train)
        if mass is None or law not in entry["laws"] or abs(tonnes - mass) > SAME_MASS * mass:
            continue
        beyond = [key for key, value in now.items() if value > entry[key] + 1e-9]
        if not beyond:
            found: dict[str, Any] | str = entry["laws"][law]
            return found, ""
        reason = f"fitted to {train} up to a {beyond[0]} of {number_text(entry[beyond[0]])} s"
    return None, reason


def fitted_trains(law: str) -> list[str]:
    """Return the names of the trains to which a law is fitted."""
    return list(dict.fromkeys(train for entry in _table() if law in entry["laws"] for train in entry["trains"]))


@functools.cache
def _table() -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = yaml.safe_load(TABLE.read_text(encoding="utf-8"))
    return found
