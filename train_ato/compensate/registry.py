"""Delay compensations by name."""

from __future__ import annotations

from train_ato.control.registry import Registry

COMPENSATIONS = Registry(
    "compensation",
    "train_ato.compensations",
    {
        "none": "train_ato.compensate.none:NoCompensation",
        "pade": "train_ato.compensate.pade:Pade",
        "preview": "train_ato.compensate.preview:Preview",
        "predictor": "train_ato.compensate.predictor:Predictor",
        "train_predictor": "train_ato.compensate.train_predictor:TrainPredictor",
        "twin": "train_ato.compensate.twin:Twin",
    },
)
"""Delay compensations."""
