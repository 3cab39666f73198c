"""Commands in this process, and their output."""

import json
from typing import Any

import pytest

from train_ato.cli.main import main


def answer(capsys: pytest.CaptureFixture[str], *words: str) -> Any:
    """Return what a command prints with ``--json``."""
    capsys.readouterr()
    status = main([*words, "--json"])
    printed = capsys.readouterr()
    assert status == 0, printed.err
    return json.loads(printed.out)


def complaint(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    """Return what a refused command prints on stderr."""
    capsys.readouterr()
    assert main([*words]) == 2
    return capsys.readouterr().err
