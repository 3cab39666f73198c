"""Layout of a recorder's file: the meaning of its columns and of its notches, as a file of its own.

A notch is a share of the largest force of the train at its speed: > 0 of the traction, < 0 of the electric brake. The
force of the notches is the demand, ``command_force``. In a file without a measured force it also replaces the measured
force.
"""

from collections.abc import Collection
from itertools import combinations
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator

from plant_sim.input_error import build_model, close_match
from plant_sim.library import read_yaml
from plant_sim.si_model import SiModel, Source, Summary
from train_ato.api.import_csv.columns import LAYOUTS, NOTCH, column_of, layout_names, plain_notch, spellings

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

    @property
    def shares(self) -> dict[str, dict[str, float]]:
        """Share of the largest force by the plain text of a notch, by title."""
        return {title: {plain_notch(key): part for key, part in rows.items()} for title, rows in self.notches.items()}


NO_LAYOUT = RecorderLayout.model_validate({"schema": "train_ato/recorder/1", "name": "none"})
"""Layout of a file with the names of train_ato."""


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
