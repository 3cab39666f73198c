"""Reject pairs of law and compensation that have no effect or compensate the delay twice."""

from __future__ import annotations

from typing import Any


def check_compatible(law_name: str, law: Any, name: str, compensation: Any) -> None:
    """Reject a law and a compensation that do nothing together or predict the delay twice.

    Parameters
    ----------
    law_name, law
        Name and law; its attributes ``uses_feedforward``, ``predicts_delay`` and their hints are read
        (:class:`train_ato.control.contract.Law`).
    name, compensation
        Name and compensation, or its class; its attributes ``feedforward_only`` and ``predicts`` are read
        (:class:`train_ato.control.compensation.contract.Compensation`).

    Raises
    ------
    ValueError
        One line with the reason and the remedy.
    """
    pair = f"law '{law_name}' with compensation '{name}'"
    if getattr(compensation, "feedforward_only", False) and not getattr(law, "uses_feedforward", True):
        setting = _setting(law_name, getattr(law, "feedforward_hint", ""))
        raise ValueError(
            f"{pair}: '{name}' gives only a feed-forward, and this law does not use it; "
            f"{setting or 'choose law pid, rbf_switching_smc or smc'}, or choose compensation none, preview or "
            "predictor"
        )
    if getattr(compensation, "predicts", False) and getattr(law, "predicts_delay", False):
        setting = _setting(law_name, getattr(law, "delay_hint", ""))
        raise ValueError(
            f"{pair}: '{name}' predicts the state over the delay, and so does this law; "
            f"{setting or 'choose another law'}, or choose compensation none or preview"
        )


def _setting(law_name: str, hint: str) -> str:
    """Return ``set law.parameter: value`` for a hint ``parameter: value``; empty for no hint."""
    return f"set {law_name}.{hint}" if hint else ""
