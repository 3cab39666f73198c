"""Which laws a compensation makes no sense with: what it gives, they leave, or have already."""

from __future__ import annotations

from typing import Any


def refuse_misfit(law_name: str, law: Any, name: str, compensation: Any) -> None:
    """Refuse a law and a compensation that would silently do nothing, or the same thing twice.

    Parameters
    ----------
    law_name, law
        The law; ``leaves_feedforward`` and ``predicts_delay`` are its own optional words on why
        (:class:`train_ato.control.contract.Law`).
    name, compensation
        The compensation or its class; ``feedforward_only`` and ``predicts`` say what it gives
        (:class:`train_ato.compensate.contract.Compensation`).

    Raises
    ------
    ValueError
        One line with the reason and the remedy.
    """
    leaves = getattr(law, "leaves_feedforward", "")
    if leaves and getattr(compensation, "feedforward_only", False):
        raise ValueError(
            f"controller '{law_name}' with compensation '{name}': all that '{name}' gives is a feed-forward, and "
            f"{leaves}, or choose compensation none, preview or predictor"
        )
    already = getattr(law, "predicts_delay", "")
    if already and getattr(compensation, "predicts", False):
        raise ValueError(
            f"controller '{law_name}' with compensation '{name}': '{name}' shows the state a delay later, and "
            f"{already}, or choose compensation none or preview"
        )
