"""Command ``train-ato``: exit status 0 success, 1 failed run, 2 bad input; errors are one line."""

from train_ato.cli.main import main

__all__ = ["main"]
