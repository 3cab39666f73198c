"""A recorded run as the arrays that figures are made of; what is missing in the log is missing here."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from train_ato.record.layout import LOG
from train_ato.record.versions import SUMMARY
from train_ato.run_setup import RunSetup
from train_ato.topics import BY_NAME
from train_ato.types import Array

if TYPE_CHECKING:
    import pandas as pd

_BLOCKS: tuple[tuple[str, str, str], ...] = (
    ("train/cars", "position", "_position_m"),
    ("train/cars", "speed", "_speed_m_s"),
    ("train/cars", "coupler", "_coupler_force_n"),
    ("train/measurement", "position", "_position_m"),
    ("train/measurement", "speed", "_speed_m_s"),
    ("train/measurement", "applied", "_applied_force_n"),
    ("train/disturbance", "force", "_disturbance_force_n"),
    ("train/brake_cylinders", "shoe_force", "_shoe_force_n"),
    ("train/brake_pipe", "pressure", "pressure_pa"),
    ("ato/brake_pipe", "pressure", "pressure_pa"),
    ("ato/reference", "position", "position_m"),
    ("ato/reference", "speed", "speed_m_s"),
    ("ato/reference", "acceleration", "acceleration_m_s2"),
    ("ato/estimate", "force", "_disturbance_force_n"),
    ("ato/command", "force", "_force_n"),
)
"""Topic, what it is called here, and how its columns end."""


@dataclass(frozen=True)
class Samples:
    """Numbers of one topic.

    Attributes
    ----------
    time : Array, shape (k,)
        Stamps [s], rising.
    values : dict of Array, each of shape (k, n)
        By name; n vehicles or units, 1 for a single number. SI.
    """

    time: Array
    values: dict[str, Array]

    def __getitem__(self, name: str) -> Array:
        return self.values[name]

    def __contains__(self, name: str) -> bool:
        return name in self.values


@dataclass(frozen=True)
class Planned:
    """One speed profile: when it was planned [s], and its knots: time [s], position [m], speed [m/s]."""

    at: float
    time: Array
    position: Array
    speed: Array


@dataclass(frozen=True)
class Said:
    """What one node said in its diagnostics, message by message; numbers where all are numbers, else texts or None."""

    time: Array
    level: Array
    message: list[str]
    values: dict[str, Any]

    def numbers(self, key: str) -> Array | None:
        """Return a value over time, NaN where it was not said; None if it never was or is no number."""
        column = self.values.get(key)
        return column if isinstance(column, np.ndarray) and np.isfinite(column).any() else None

    def texts(self, key: str) -> list[str | None]:
        """Return a value as it was said, None where it was not."""
        column = self.values.get(key)
        if column is None:
            return [None] * self.time.size
        if isinstance(column, np.ndarray):
            return [f"{entry:g}" if np.isfinite(entry) else None for entry in column]
        return list(column)


@dataclass(frozen=True)
class Recording:
    """One run.

    Attributes
    ----------
    name
        Name of its folder.
    summary
        What ``summary.json`` holds; for a recovered or imported run what there is of it.
    setup
        Scenario, train and line; None where the folder has no scenario, ``setup_missing`` says why.
    topics : dict of Samples
        By the name in the topic table.
    profiles, limits
        Profiles in the order in which they were planned; places [m] and speeds [m/s] of the limits.
    said : dict of Said
        Diagnostics by node.
    """

    name: str
    path: Path
    summary: dict[str, Any]
    setup: RunSetup | None
    setup_missing: str = ""
    topics: dict[str, Samples] = field(default_factory=dict)
    profiles: list[Planned] = field(default_factory=list)
    limits: tuple[Array, Array] | None = None
    said: dict[str, Said] = field(default_factory=dict)

    def of(self, topic: str, name: str) -> tuple[Array, Array] | None:
        """Return time and values of a topic, shapes (k,) and (k, n), or None."""
        samples = self.topics.get(topic)
        return None if samples is None or name not in samples else (samples.time, samples[name])

    @property
    def motion(self) -> Samples | None:
        """Position and speed of vehicle 0 over time: the truth, or what was measured where there is no truth."""
        for topic in ("train/cars", "train/measurement"):
            samples = self.topics.get(topic)
            if samples is not None and samples.time.size and "speed" in samples:
                return samples
        return None

    @property
    def measured_only(self) -> bool:
        """Whether the log holds no truth, as that of a measured run."""
        return "train/cars" not in self.topics

    def recorded(self, what: str) -> bool:
        """Tell whether a measured run's ``command`` or ``reference`` was measured; a simulated run has both."""
        return not str(self.summary.get(f"measured_{what}", "")).startswith("not recorded")

    @property
    def without_brake(self) -> str:
        """Why nothing of an air brake can be shown: of a measured run the log may lack what the train has."""
        braked = self.setup is None or self.setup.consist.air_brake is not None
        return "the log has nothing of an air brake" if braked else "the train has no air brake"

    @property
    def span(self) -> tuple[float, float]:
        """First and last stamp [s]."""
        times = [samples.time for samples in self.topics.values() if samples.time.size]
        return (min(float(t[0]) for t in times), max(float(t[-1]) for t in times)) if times else (0.0, 0.0)


def read_recording(run: Path) -> Recording:
    """Read a run folder or a log.

    Raises
    ------
    ValueError
        One line: no run, a killed one (``train-ato recover`` makes it readable), or a damaged log.
    """
    from train_ato.frames.loading import load

    frames = load(run)
    setup, summary, missing = _surroundings(run)
    known = {name: frame for name, frame in frames.items() if name in BY_NAME and len(frame)}
    if not known:
        raise ValueError(f"{run}: the log holds no message of ours; there is nothing to draw")
    return Recording(
        name=_name(run),
        path=run,
        summary=summary,
        setup=setup,
        setup_missing=missing,
        topics=_topics(known),
        profiles=_profiles(known.get("ato/profile")),
        limits=_limits(known.get("ato/limits")),
        said=_said(known.get("/diagnostics")),
    )


def _name(run: Path) -> str:
    """Return what a run is called: like its folder, a log of another name like itself."""
    if run.is_dir():
        return run.resolve().name
    return run.resolve().parent.name if run.name == LOG else run.stem


def _surroundings(run: Path) -> tuple[RunSetup | None, dict[str, Any], str]:
    """Return scenario and summary as far as they can be read: those of the folder, else what is attached to the log.

    A folder speaks only for its own log: another file that lies in it is another run.
    """
    from train_ato.run_folder import open_run  # which draws the figure of a run with the parts of the report

    folder = run.parent if run.is_file() and run.name == LOG else run
    missing = ""
    for place in dict.fromkeys((folder, run)):
        try:
            setup, summary = open_run(place)
            return setup, summary, ""
        except ValueError as error:
            missing = missing or str(error)
    file = folder / SUMMARY
    try:
        found = json.loads(file.read_text(encoding="utf-8")) if file.is_file() else {}
    except ValueError:
        found = {}
    return None, found if isinstance(found, dict) else {}, missing


def _topics(frames: dict[str, pd.DataFrame]) -> dict[str, Samples]:
    result: dict[str, Samples] = {}
    for topic, name, ending in _BLOCKS:
        frame = frames.get(topic)
        if frame is None:
            continue
        columns = [place for place, column in enumerate(frame.columns) if str(column).endswith(ending)]
        if not columns:
            continue
        samples = result.setdefault(topic, Samples(frame.index.to_numpy(dtype=np.float64), {}))
        together = columns[-1] - columns[0] + 1 == len(columns)
        chosen = slice(columns[0], columns[-1] + 1) if together else columns
        samples.values[name] = frame.iloc[:, chosen].to_numpy(dtype=np.float64)
    return result


def _profiles(frame: pd.DataFrame | None) -> list[Planned]:
    if frame is None:
        return []
    planned = frame["planned_s"].to_numpy() if "planned_s" in frame else np.zeros(len(frame))
    time, position, speed = (np.asarray(part) for part in (frame.index, frame["position_m"], frame["speed_m_s"]))
    return [
        Planned(float(at), time[planned == at], position[planned == at], speed[planned == at])
        for at in np.unique(planned)
    ]


def _limits(frame: pd.DataFrame | None) -> tuple[Array, Array] | None:
    if frame is None:
        return None
    return frame["position_m"].to_numpy(), frame["speed_m_s"].to_numpy()


def _said(frame: pd.DataFrame | None) -> dict[str, Said]:
    """Split the diagnostics by node, under the keys that the nodes use."""
    if frame is None:
        return {}
    from train_ato.frames.columns import diagnostic_column

    result: dict[str, Said] = {}
    for node, rows in frame.groupby("node", sort=False):
        values: dict[str, Any] = {}
        for column in rows.columns.difference(["node", "level", "message"], sort=False):
            entries = rows[column]
            if entries.notna().any():
                plain = entries.to_numpy(dtype=np.float64) if entries.dtype.kind == "f" else _texts(entries)
                values[_key_of(str(column), diagnostic_column)] = plain
        result[str(node)] = Said(
            rows.index.to_numpy(dtype=np.float64), rows["level"].to_numpy(), list(rows["message"]), values
        )
    return result


def _texts(entries: pd.Series[Any]) -> list[str | None]:
    return [entry if isinstance(entry, str) else None for entry in entries]


def _key_of(column: str, named: Any) -> str:
    """Return the key of a column whose name ends in its unit."""
    parts = column.split("_")
    for end in range(1, len(parts)):
        key = "_".join(parts[:end])
        if named(key) == column and key != column:
            return key
    return column
