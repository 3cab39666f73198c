"""Synthetic files of an on-board recorder, and the command that imports them."""

import json
from pathlib import Path

import numpy as np

from train_ato.cli.main import main

TRAIN = ["--train", "xuzhou_metro_3", "--line", "level"]
MASS, ACCELERATION, BRAKE, TOP = 181e3, 0.8, 0.7, 15.0
CRUISE = (5 + TOP / ACCELERATION, 65 + TOP / ACCELERATION)


def metro(time):
    """Return speed, position and force of a metro between two stops, with 5 s at rest at the start."""
    fine = np.linspace(0, 140, 140_001)
    a = np.where((fine > 5) & (fine < CRUISE[0]), ACCELERATION, 0.0)
    a = np.where((fine > CRUISE[1]) & (fine < CRUISE[1] + TOP / BRAKE), -BRAKE, a)
    v = np.maximum(np.concatenate(([0.0], np.cumsum(a[:-1]))) * 1e-3, 0.0)
    v[fine >= CRUISE[1] + TOP / BRAKE] = 0.0
    x = 500 + np.concatenate(([0.0], np.cumsum((v[1:] + v[:-1]) / 2))) * 1e-3
    return tuple(np.interp(time, fine, entry) for entry in (v, x, MASS * a))


def text_of(columns: dict[str, object], separator=",", digits=None) -> str:
    """Return a CSV text."""
    rows = zip(*(list(values) for values in columns.values()), strict=True)

    def cell(value):
        return value if isinstance(value, str) else repr(float(value)) if digits is None else f"{value:.{digits}f}"

    lines = [separator.join(columns), *(separator.join(cell(value) for value in row) for row in rows)]
    return "\n".join(lines) + "\n"


def recorded(step=0.2, end=120.0, **changes) -> str:
    time = np.arange(0.0, end + step / 2, step)
    v, x, f = metro(time)
    return text_of({"time_s": time, "speed_kmh": 3.6 * v, "position_m": x, "force_kn": f / 1e3, **changes})


def take(tmp_path: Path, capsys, text: str, *options: str, train=TRAIN, name="run.csv") -> dict:
    """Import a text into the folder ``imported``; return the output."""
    (tmp_path / name).write_text(text)
    status = main(["import", str(tmp_path / name), *train, "--out", str(tmp_path / "imported"), "--json", *options])
    captured = capsys.readouterr()
    assert status == 0, captured.err
    return json.loads(captured.out)


def refused(tmp_path: Path, capsys, text: str | bytes, *options: str, train=TRAIN, faults: int = 1) -> str:
    """Import an invalid text; return the error lines, one for each fault."""
    (tmp_path / "rec.csv").write_bytes(text if isinstance(text, bytes) else text.encode())
    try:
        status = main(["import", str(tmp_path / "rec.csv"), *train, "--out", str(tmp_path / "imported"), *options])
    except SystemExit as end:
        status = int(end.code or 0)
    captured = capsys.readouterr()
    assert status == 2, (captured.out, captured.err)
    assert captured.out == ""
    assert len(captured.err.splitlines()) == faults
    assert sorted(path.name for path in tmp_path.iterdir()) == ["rec.csv"]
    return captured.err
