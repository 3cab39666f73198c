"""Reject pairs of law and compensation that have no effect or compensate the delay twice."""

from __future__ import annotations

from typing import Any


def check_compatible(law_name: str, law: Any, name: str, compensation: Any) -> None:
    """Reject a law and a compensation that do nothing together or predict the delay twice.

    Parameters
    ----------
    law_name, law
        Name and law; its attributes ``uses_feedforward``, ``follows_simulation``, ``predicts_delay`` and hints are read
        (:class:`train_ato.control.contract.Law`).
    name, compensation
        Name and compensation, or its class; its attributes ``feedforward_only``, ``simulates_train``, ``predicts``
        are read
        (:class:`train_ato.control.compensation.contract.Compensation`).

    Raises
    ------
    ValueError
        One line with the reason and the remedy.
    """
    pair = f"law '{law_name}' with compensation '{name}'"
    predicting = getattr(law, "predicts_delay", False)
    follows = getattr(law, "follows_simulation", False) and getattr(compensation, "simulates_train", False)
    if getattr(compensation, "feedforward_only", False) and not (getattr(law, "uses_feedforward", True) or follows):
        remedy = _remedy(law_name, getattr(law, "feedforward_hint", ""), predicting)
        raise ValueError(f"{pair}: '{name}' gives only a feed-forward, and this law does not use it; {remedy}")
    if getattr(compensation, "predicts", False) and predicting:
        remedy = _remedy(law_name, getattr(law, "delay_hint", ""), predicting)
        raise ValueError(f"{pair}: '{name}' predicts the state over the delay, and so does this law; {remedy}")


def _remedy(law_name: str, hint: str, predicting: bool) -> str:
    """Return the accepted settings as text.

    Parameters
    ----------
    law_name
        Name of the law.
    hint
        Setting ``parameter: value`` of the law that fits the compensation; "" if there is none.
    predicting
        The law predicts the delay: then no predicting compensation is accepted.
    """
    setting = f"set laws.{law_name}.{hint}" if hint else "set law: pid (--law pid)"
    others = "none or preview" if predicting else "none, preview or predictor"
    return f"{setting}, or compensation: {others} (--compensation none)"
