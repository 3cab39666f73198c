"""Programs of the tests in processes of their own; ``conftest.py`` lets them import the tested package."""

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

from waiting import LIMIT_S


def python(*words: str, folder: Path | None = None, **variables: str) -> subprocess.CompletedProcess[str]:
    """Run Python to its end in a folder, with more variables of its environment and its output kept."""
    environment = {**os.environ, **variables}
    return subprocess.run(
        [sys.executable, *words], cwd=folder, env=environment, capture_output=True, text=True, timeout=2 * LIMIT_S
    )


def begun(*words: str, **options: Any) -> subprocess.Popen[str]:
    """Start ``train-ato`` with its output in pipes, or with other options of the process."""
    pipes: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    return subprocess.Popen([sys.executable, "-m", "train_ato", *words], **{**pipes, **options})
