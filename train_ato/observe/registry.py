"""Disturbance observers by name."""

from __future__ import annotations

from train_ato.control.registry import Registry

OBSERVERS = Registry(
    "observer",
    "train_ato.observers",
    {
        "none": "train_ato.observe.none:NoObserver",
        "ndo": "train_ato.observe.ndo:Ndo",
        "cascaded": "train_ato.observe.cascaded:Cascaded",
        "eso": "train_ato.observe.eso:Eso",
    },
)
"""Observers."""
