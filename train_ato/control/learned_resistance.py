"""Resistance of a train by place that former runs of the line have shown, in addition to the nominal model.

With the inertial mass M of the nominal train and the place x of vehicle 0's centre::

    W(x, v) = W_0(v) + W_line(x) + M r(x)

r(x) is linear between evenly spaced places and 0 beyond them. All laws, observers and compensations take W from the
nominal model, so that r acts in every feed-forward and in every prediction. ``train-ato learn`` makes the file.
"""

import hashlib
import json
from pathlib import Path
from typing import Literal

import numpy as np
import yaml
from pydantic import Field, model_validator

from plant_sim.consist import Consist
from plant_sim.input_error import build_model
from plant_sim.library import read_yaml
from plant_sim.line import Line
from plant_sim.si_model import SiModel, Source
from plant_sim.units import Acceleration, Place
from train_ato.messages.types import Array

SCHEMA = "train_ato/learned/1"
MAX_RESISTANCE = 0.5
"""Largest learned resistance per inertial mass [m/s²]: a grade of 50 per mille."""
DIGITS = 6
"""Decimals of a value in m/s²: 1e-6 m/s² changes the speed by less than 1 mm/s in 10 minutes."""


class LearnedResistance(SiModel):
    """Learned resistance of a train by place on a line."""

    schema_: Literal["train_ato/learned/1"] = Field(alias="schema", description="kind and version of the file")
    source: Source = ""
    line: str = Field(description="name of the line of the runs", examples=["metro_12_km"])
    train: str = Field(description="name of the nominal train of the runs", examples=["metro_6_cars"])
    model: str = Field(description="hash of the nominal train and line of the runs", examples=["0f3a9c"])
    runs: int = Field(ge=1, description="number of runs", examples=[3])
    begin: Place = Field(description="place of vehicle 0's centre at the first value", examples=[150.0])
    spacing: Place = Field(gt=0, description="distance between the values", examples=[25.0])
    resistance: tuple[Acceleration, ...] = Field(
        min_length=2,
        max_length=2_000_000,
        description="force per inertial mass, > 0 retards",
        examples=[(0.001, 0.0012)],
    )

    @model_validator(mode="after")
    def _bounded(self) -> "LearnedResistance":
        wrong = [value for value in self.resistance if not abs(value) <= MAX_RESISTANCE]
        if wrong:
            raise ValueError(
                f"resistance: {wrong[0]:g} m/s² is beyond +-{MAX_RESISTANCE:g}; learn again, or correct it"
            )
        return self

    @property
    def places(self) -> Array:
        """Places of the values [m]."""
        return np.asarray(self.begin + self.spacing * np.arange(len(self.resistance)), dtype=np.float64)

    def at(self, places: Array) -> Array:
        """Return the learned resistance per inertial mass at places of vehicle 0's centre [m/s²]."""
        return np.asarray(np.interp(places, self.places, self.resistance, left=0.0, right=0.0))

    def check_fits(self, line: Line, consist: Consist, model: str) -> None:
        """Check that the runs were on this line with this nominal model.

        Parameters
        ----------
        line
            Line of the run.
        consist
            Nominal train.
        model
            Hash of the nominal train and line, :func:`model_hash`.

        Raises
        ------
        ValueError
            For another line, train or model: key, value, problem; fix.
        """
        for key, learned, present in (("line", self.line, line.name), ("train", self.train, consist.name)):
            if learned != present:
                raise ValueError(
                    f"{key}: learned for '{learned}', this run has '{present}'; learn again for this {key}"
                )
        if self.model != model:
            raise ValueError(f"model: learned with the nominal model {self.model}, this run has {model}; learn again")


def model_hash(consist: Consist, line: Line, *, over_length: bool) -> str:
    """Return a hash of the nominal train and line, without their names and texts."""
    parts = [part.model_dump(mode="json", exclude={"name", "summary", "source"}) for part in (consist, line)]
    return hashlib.sha256(json.dumps([*parts, over_length], sort_keys=True).encode()).hexdigest()[:16]


def read_learned(path: Path) -> LearnedResistance:
    """Read a learned resistance."""
    raw = read_yaml(path)
    if isinstance(raw, dict) and raw.get("schema") != SCHEMA:
        raise ValueError(f"{path}: schema: {raw.get('schema')!r}: not supported; make the file with `train-ato learn`")
    return build_model(LearnedResistance, raw, str(path))


def learned_text(learned: LearnedResistance) -> str:
    """Return a learned resistance as YAML; reading it restores the same values."""
    data = learned.model_dump(mode="json", by_alias=True)
    dumper = getattr(yaml, "CSafeDumper", yaml.SafeDumper)
    return yaml.dump(data, Dumper=dumper, sort_keys=False, allow_unicode=True, default_flow_style=None, width=120)
