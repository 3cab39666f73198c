"""Faults of a recorder's file, collected so that one command names them all."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from plant_sim.input_error import InputFaults

_Result = TypeVar("_Result")


class FileFaults:
    """Faults of one file, in the order of their discovery."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._texts: list[str] = []
        self._kinds: dict[tuple[str, str], int] = {}
        self._more: dict[int, int] = {}

    def add(self, text: str) -> None:
        """Add a fault: place and problem, without the file."""
        if text not in self._texts:
            self._texts.append(text)

    def add_of_kind(self, place: str, kind: str, text: str) -> None:
        """Add a fault of a column or the rows; further ones of its kind there are only counted."""
        at = self._kinds.get((place, kind))
        if at is None:
            self._kinds[place, kind] = len(self._texts)
            self._texts.append(text)
        else:
            self._more[at] = self._more.get(at, 0) + 1

    def attempt(self, check: Callable[..., _Result], *data: Any) -> _Result | None:
        """Return the result of a check; None if it raises ValueError, whose text is added."""
        try:
            return check(*data)
        except ValueError as error:
            self.add(str(error).removeprefix(f"{self.path}: "))
            return None

    def refuse(self) -> None:
        """Raise InputFaults if the file has faults."""
        if not self._texts:
            return
        lines = []
        for number, text in enumerate(self._texts):
            more = f" (and {self._more[number]} more of this kind)" if number in self._more else ""
            lines.append(f"{self.path}: {text}{more}")
        raise InputFaults.of(lines, self.path)
