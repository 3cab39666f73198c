"""``train-ato plan``: the driving profile alone, for a line and a train, with a figure and without a run."""

from train_ato.plan.command import add_arguments, execute

__all__ = ["add_arguments", "execute"]
