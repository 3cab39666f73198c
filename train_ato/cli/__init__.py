"""The command ``train-ato``: exit status 0 done, 1 the run failed, 2 bad input; errors are one line."""

from train_ato.cli.main import main

__all__ = ["main"]
