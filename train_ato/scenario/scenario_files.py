"""Scenario files by name: the shipped ones, those of a user, their bases and variants, all of them not yet checked.

A shell completes names with this module, so it imports neither the models of a scenario nor the compiler.
"""

from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any

from plant_sim.input_error import close_match, kind_of
from plant_sim.library import read_yaml, split_name
from train_ato.scenario.overlays import overlay, with_absolute_files

SCHEMA = "train_ato/scenario/1"
FOLLOWING = "train_ato/following/"
"""Begin of the schema of a file of trains behind each other."""
OF_FILES = ("summary", "expect")
"""Keys of a variant that describe it and are no change of the run."""
MAX_FILE = 64 * 2**20
"""Maximum size of a scenario file [bytes]."""


def shipped_scenarios() -> dict[str, Path]:
    """Return the shipped scenario files by name."""
    folder = Path(str(files("train_ato"))) / "scenario" / "shipped"
    return {path.stem: path for path in sorted(folder.glob("*.yaml"))}


def scenario_names() -> list[str]:
    """Return every shipped scenario with its variants."""
    shipped = shipped_scenarios().items()
    return [full for name, path in shipped for full in (name, *(f"{name}:{key}" for key in variants_of(path)))]


def shipped_following() -> dict[str, Path]:
    """Return the shipped files of trains behind each other by name."""
    folder = Path(str(files("train_ato"))) / "scenario" / "shipped" / "following"
    return {path.stem: path for path in sorted(folder.glob("*.yaml"))}


def _read(path: Path) -> dict[str, Any]:
    if path.is_file() and path.stat().st_size > MAX_FILE:
        raise ValueError(f"{path}: larger than {MAX_FILE} bytes; name a scenario file")
    data = read_yaml(path)
    if not isinstance(data, dict):
        raise ValueError(f"{path}: a scenario is a mapping of keys, not {kind_of(data)}; correct the file")
    return data


def find(name: str) -> tuple[Path, str | None]:
    """Return file and variants of ``SCENARIO[:variant[+variant...]]``.

    Raises
    ------
    ValueError
        If there is neither a shipped scenario nor a file of that name.
    """
    stem, variant = split_name(name)
    path = Path(stem)
    if not (path.suffix in (".yaml", ".yml") or path.is_file()):
        shipped = shipped_scenarios() | shipped_following()
        if stem not in shipped:
            own = [file for file in (path / "scenario.yaml", Path(f"{stem}.yaml")) if file.is_file()]
            near = f"; did you mean the file '{own[0]}'?" if own else close_match(stem, shipped)
            raise ValueError(f"unknown scenario '{stem}'{near}; see `train-ato list`")
        path = shipped[stem]
    elif not path.is_file():
        near = close_match(path.stem, shipped_scenarios() | shipped_following())
        raise ValueError(f"{path}: no such file{near}; name a scenario file or one of `train-ato list`")
    return path, variant[1:] if variant else None


def with_base(path: Path, above: tuple[Path, ...] = (), given: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Return a scenario file, or its given content, on its base ``SCENARIO[:variant...]``, with its variants."""
    data = _read(path) if given is None else {"schema": SCHEMA, **given}
    base = data.pop("base", None)
    if base is None:
        return data
    beside = path.parent / str(base)
    below, variant = find(str(beside) if Path(split_name(str(beside))[0]).is_file() else str(base))
    if below in (path, *above):
        raise ValueError(f"{path}: base: {base}: a scenario is its own base; name another base")
    found = with_variants(below, with_base(below, (path, *above)), variant)
    for block in (found, *(found.get("variants") or {}).values()):
        block.pop("expect", None)
    if below.parent != path.parent:
        found = with_absolute_files(found, below.parent)
    return overlay(found, data)


def with_variants(path: Path, data: dict[str, Any], variant: str | None) -> dict[str, Any]:
    """Return a scenario with the overlays of ``variant[+variant...]`` applied; its variants remain."""
    variants = data.get("variants") or {}
    for part in variant.split("+") if variant is not None else ():
        if part not in variants:
            known = ", ".join(sorted(variants)) or "none"
            raise ValueError(f"{path}: no variant '{part}'{close_match(part, variants)}; use one of: {known}")
        data = overlay(data, {key: value for key, value in variants[part].items() if key not in OF_FILES})
    return data


def variants_of(path: Path) -> dict[str, str]:
    """Return the variants of a scenario file with their one-line summaries."""
    variants = with_base(path).get("variants") or {}
    return {name: str(change.get("summary", "")) for name, change in variants.items()}
