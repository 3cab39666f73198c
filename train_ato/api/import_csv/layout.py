"""Layout of a recorder's file: the meaning of its columns and of its notches, as a file of its own.

A notch is a share of the largest force of the train at its speed: > 0 of the traction, < 0 of the electric brake. The
force of the notches is the demand, ``command_force``. In a file without a measured force it also replaces the measured
force.
"""

from collections.abc import Collection
from itertools import combinations
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BeforeValidator, Field, model_validator

from plant_sim.consist import Consist
from plant_sim.elementary import plain_sum
from plant_sim.input_error import build_model, close_match
from plant_sim.library import read_yaml
from plant_sim.si_model import SiModel, Source, Summary
from plant_sim.traction import Envelope
from train_ato.api.import_csv.columns import LAYOUTS, NOTCH, Column, column_of, layout_names, spellings
from train_ato.api.import_csv.table import CsvTable, FileRules, plain_notch

FORCES = ("force", "traction_force", "brake_force")
Share = Annotated[float, Field(ge=-1, le=1)]


def _texts(notches: Any) -> Any:
    """Return notches by their texts; YAML reads 8 as a number."""
    return {str(key): share for key, share in notches.items()} if isinstance(notches, dict) else notches


class RecorderLayout(SiModel):
    """Layout of the files of one kind of recorder."""

    schema_: Literal["train_ato/recorder/1"] = Field(alias="schema", description="kind and version of the file")
    name: str = Field(description="name in lists", examples=["us_locomotive"])
    summary: Summary = ""
    source: Source = ""
    skip_lines: int = Field(0, ge=0, description="lines above the column names", examples=[3])
    separator: str = Field(
        "", max_length=1, description="mark between the columns; default: found in the file", examples=[";"]
    )
    columns: dict[str, str] = Field(
        default_factory=dict,
        description="name in train_ato by the title in the file; titles that a file does not have are passed over",
        examples=[{"Spd": "speed_mph"}],
    )
    date: str = Field("", description="title of the date of a column that is timestamp", examples=["Datum"])
    notches: dict[str, Annotated[dict[str, Share], BeforeValidator(_texts)]] = Field(
        default_factory=dict,
        description="share of the largest force by notch, > 0 traction, < 0 electric brake, by title",
        examples=[{"Handle": {"B1": -0.5, "N": 0.0, "P1": 0.5, "P2": 1.0}}],
    )
    gauge: bool = Field(False, description="pressures above that of the air")
    sort: bool = Field(False, description="sort the rows by time and remove repeated rows, as --sort does")
    ignore: tuple[str, ...] = Field((), description="titles that are not read", examples=[["Horn"]])
    ignore_others: bool = Field(False, description="no fault for a title that is in no key")

    @model_validator(mode="after")
    def _one_meaning(self) -> "RecorderLayout":
        for title, name in self.columns.items():
            try:
                column_of(title, name)
            except ValueError:
                near = close_match(name, spellings()) or "; the names are those of train-ato import --help"
                raise ValueError(f"columns: {title}: '{name[:40]}' is no column of train_ato{near}") from None
        uses: dict[str, Collection[str]] = {
            "columns": self.columns, "notches": self.notches, "ignore": self.ignore, "date": (self.date,),
        }  # fmt: skip
        for (one, titles), (other, others) in combinations(uses.items(), 2):
            if twice := sorted({*titles} & {*others}):
                raise ValueError(f"'{twice[0]}' is in {one} and in {other}; keep one of them")
        for title, shares in self.notches.items():
            if len({plain_notch(key) for key in shares}) < len(shares):
                raise ValueError(f"notches: {title}: one notch twice, as {', '.join(shares)}; keep one of them")
        return self

    def renames(self) -> dict[str, str]:
        """Return the name of every column of the layout by its title."""
        return {**self.columns, **dict.fromkeys(self.notches, NOTCH)}

    def rules(self) -> FileRules:
        """Return the rules for the file itself."""
        shares = {title: {plain_notch(key): part for key, part in rows.items()} for title, rows in self.notches.items()}
        return FileRules(self.skip_lines, self.separator, self.date, shares, self.gauge, self.ignore_others)


def load_layout(name: str) -> RecorderLayout:
    """Return a layout by name or path."""
    known = layout_names()
    path = LAYOUTS / f"{name}.yaml" if name in known else Path(name)
    if not path.is_file():
        raise ValueError(
            f"layout '{name}' is neither shipped nor a file; give a path or one of {', '.join(known)}"
            f"{close_match(name, known)}"
        )
    return build_model(RecorderLayout, read_yaml(path), str(path))


def add_notch_force(table: CsvTable, consist: Consist) -> str:
    """Replace the notches of a file by their force; return a note, "" without notches.

    Notches beside a demand, and without a speed of the train, are refused.
    """
    notches = [column for column in table.columns.values() if column.quantity == NOTCH]
    if not notches:
        return ""
    title = notches[0].title
    speed, given = table.find("speed") or table.find("speed", 0), table.find("command_force")
    if given is not None:
        raise ValueError(f"{table.path}: '{title}' and '{given.title}' are both the demand; --ignore one")
    if speed is None:
        raise ValueError(f"{table.path}: '{title}' has its force at the speed; name the speed of the train speed_kmh")
    units = [consist.vehicles[unit] for unit in consist.power_units]
    traction = [Envelope(unit.traction) for unit in units]
    brake = [Envelope(unit.electric_brake or unit.brake) for unit in units]
    both = int(np.count_nonzero(np.count_nonzero([table.values[entry.title] for entry in notches], axis=0) > 1))
    share = sum((table.values[column.title] for column in notches), np.zeros(table.lines.size))
    rows = np.arange(table.lines.size)
    known = ~np.isnan(table.values[speed.title])
    moving = np.abs(np.interp(rows, rows[known], table.values[speed.title][known])) if known.any() else rows * 0.0
    force = np.array(
        [
            part * plain_sum(envelope.force(v) for envelope in (traction if part > 0 else brake)) if part else part
            for part, v in zip(share.tolist(), moving.tolist(), strict=True)
        ]
    )
    for column in notches:
        del table.columns[column.title], table.values[column.title]
    measured = any(column.quantity in FORCES for column in table.columns.values())
    for quantity in ("command_force",) if measured else ("command_force", "force"):
        name = f"{title} as {quantity}"
        table.columns[name], table.values[name] = Column(name, quantity, 1.0), force
        table.decimals[name] = -1
    use = "the demand" if measured else "the demand and, without a measured force in the file, the force"
    twice = f"; in {both} rows the shares of two handles add" if both else ""
    return f"{title}: share of the largest force at the speed; it is {use}{twice}"
