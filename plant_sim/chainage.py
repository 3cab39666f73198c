"""Kilometres of a line as its posts show them: rising or falling, with jumps, written ``12+345``.

A place of the program is a distance in the direction of running. The sections of the chainage of a line follow each
other without a gap: where the chainage jumps, the next section begins with another kilometre at the same place.
"""

import re
from collections.abc import Callable, Sequence
from typing import Any

from pydantic import Field, model_validator

from plant_sim.elementary import plain_sum
from plant_sim.si_model import SiModel
from plant_sim.units import Place, number_text

FORM = re.compile(r"(-?)(\d{1,6})\+(\d{3}(?:\.\d{1,6})?)")
"""Kilometres and metres of a post."""
PLACES = ("at", "begin", "end")
"""Keys of places, also with the suffix ``_km``."""
_ENDS = ("begin", "begin_km", "end", "end_km")
"""Keys of the ends of a line."""
ROUNDING = 1e-6
"""Rounding of places [m]."""
WIDEST_GAP = 200.0
"""Largest distance of a recorded kilometre from those of the line [m]."""


class ChainageSection(SiModel):
    """Section of a line with continuous kilometres, in the order of running; falling if its end is the lower one."""

    begin: Place = Field(description="kilometre at its begin, a number or 12+345", examples=[84500.0])
    end: Place = Field(description="kilometre at its end, a number or 12+345", examples=[80200.0])

    @model_validator(mode="before")
    @classmethod
    def _posts(cls, data: Any) -> Any:
        return _without_posts(data, lambda _, text: parse_post(text)) if isinstance(data, dict) else data

    @model_validator(mode="after")
    def _has_length(self) -> "ChainageSection":
        if self.begin == self.end:
            raise ValueError(f"a section from {post(self.begin)} to {post(self.end)} has no length; correct it")
        return self

    @property
    def length(self) -> float:
        """Length of the section [m]."""
        return abs(self.end - self.begin)


def parse_post(text: str) -> float | None:
    """Return the kilometre of ``12+345`` [m]; None for another text."""
    found = FORM.fullmatch(text.strip())
    if found is None:
        return None
    size = 1e3 * int(found[2]) + float(found[3])
    return -size if found[1] else size


def _without_posts(data: dict[str, Any], metres: Callable[[str, str], float | None]) -> dict[str, Any]:
    """Return a block with metres for the texts of its places; a post is the same post below ``at`` and ``at_km``."""
    found: dict[str, Any] = {}
    for key, value in data.items():
        name = str(key).removesuffix("_km")
        place = metres(key, value) if isinstance(value, str) and name in PLACES else None
        if place is None:
            found[key] = value
        else:
            found[key if name in data else name] = place  # both keys: refused as the same quantity
    return found


class _Extent(SiModel):
    """Keys of a line file that define where its chainage lies."""

    chainage: tuple[ChainageSection, ...]
    begin: Place = 0.0
    end: Place | None = None


def post(chainage: float, digits: int = 3) -> str:
    """Return a kilometre [m] as ``12+345``, with the digits of a metre that it has.

    Examples
    --------
    >>> post(84500.0), post(12345.25), post(-100.0)
    ('84+500', '12+345.25', '-0+100')
    """
    size = round(abs(chainage), digits)
    kilometres = int(size // 1000)
    metres = f"{size - 1000 * kilometres:0{4 + digits}.{digits}f}".rstrip("0").rstrip(".")
    return f"{'-' if chainage < 0 < size else ''}{kilometres}+{metres.zfill(3)}"


def post_at(sections: Sequence[ChainageSection], begin: float, place: float, digits: int = 3) -> str:
    """Return the post of a place [m], with ``digits`` of a metre, on a line that begins at ``begin`` [m].

    Beyond the ends of the line the kilometres go on.
    """
    left = place - begin
    for section in sections[:-1]:
        if left < section.length - ROUNDING:
            break
        left -= section.length
    else:
        section = sections[-1]
    return post(round(section.begin + (left if section.end > section.begin else -left), digits))


def place_of_post(sections: Sequence[ChainageSection], begin: float, text: str) -> float:
    """Return the place of a post [m] on a line that begins at ``begin`` [m].

    Raises
    ------
    ValueError
        If the text is no post, or the line has this kilometre nowhere or twice.
    """
    chainage = parse_post(text)
    if chainage is None:
        raise ValueError(f"'{text}' is no kilometre; write 12+345")
    found: list[float] = []
    passed = begin
    for section in sections:
        along = abs(chainage - section.begin)
        inside = min(section.begin, section.end) - ROUNDING <= chainage <= max(section.begin, section.end) + ROUNDING
        if inside and not any(abs(passed + along - other) <= ROUNDING for other in found):
            found.append(passed + along)
        passed += section.length
    if len(found) != 1:
        where = "nowhere" if not found else f"at {' and '.join(number_text(place) for place in found)} m"
        raise ValueError(f"'{text}': the line has this kilometre {where}; write the distance in running direction")
    return found[0]


def places_along(sections: Sequence[ChainageSection], begin: float, kilometres: Sequence[float]) -> list[float] | None:
    """Return the places [m] of kilometres [m] in their order along a line; None if one of them lies nowhere.

    Of a kilometre that the line has twice, the place nearest to the one before counts. In a gap of the kilometres the
    place is the jump.
    """
    found: list[float] = []
    for kilometre in kilometres:
        choices, passed = [], begin
        for section in sections:
            low, high = sorted((section.begin, section.end))
            inside = min(max(kilometre, low), high)
            place = passed + abs(inside - section.begin)
            choices.append((abs(inside - kilometre), abs(place - found[-1]) if found else 0.0, place))
            passed += section.length
        beside, _, place = min(choices)
        if beside > WIDEST_GAP:
            return None
        found.append(place)
    return found


def with_places(data: dict[str, Any]) -> dict[str, Any]:
    """Return the keys of a line file with distances for the posts of its chainage."""
    given = _Extent.model_validate({key: data[key] for key in ("chainage", *_ENDS) if key in data})
    sections, begin = given.chainage, given.begin
    if not sections:
        return data
    whole = plain_sum(section.length for section in sections)
    end = begin + whole if given.end is None else given.end
    if abs(end - begin - whole) > 1e-3:
        raise ValueError(
            f"chainage: its sections have {number_text(whole)} m, the line {number_text(end - begin)} m; correct one"
        )
    result = {key: value for key, value in data.items() if key not in _ENDS} | {"begin": begin, "end": end}
    for key, entries in data.items():
        if key != "chainage" and isinstance(entries, list):
            result[key] = rows_with_places(entries, sections, begin, key)
    return result


def rows_with_places(rows: list[Any], sections: Sequence[ChainageSection], begin: float, key: str) -> list[Any]:
    """Return the entries of a key of a file with distances for their posts."""
    return [_with_place(entry, sections, begin, f"{key}[{k}]") for k, entry in enumerate(rows)]


def _with_place(entry: Any, sections: Sequence[ChainageSection], begin: float, name: str) -> Any:
    if not isinstance(entry, dict):
        return entry

    def metres(key: str, text: str) -> float:
        try:
            return place_of_post(sections, begin, text)
        except ValueError as error:
            raise ValueError(f"{name}.{key}: {error}") from None

    return {
        key: rows_with_places(value, sections, begin, f"{name}.{key}") if isinstance(value, list) else value
        for key, value in _without_posts(entry, metres).items()
    }


def with_posts(data: dict[str, Any], sections: Sequence[ChainageSection], begin: float) -> dict[str, Any]:
    """Return the keys of a line with posts for the distances that they give exactly; the others stay."""

    def written(value: float) -> float | str:
        text = post_at(sections, begin, value)
        try:
            return text if place_of_post(sections, begin, text) == value else value
        except ValueError:
            return value

    def entry_with_posts(entry: Any) -> Any:
        if not isinstance(entry, dict):
            return entry
        return {
            key: written(value)
            if key in PLACES
            else [*map(entry_with_posts, value)]
            if isinstance(value, list)
            else value
            for key, value in entry.items()
        }

    result = {key: [*map(entry_with_posts, value)] if isinstance(value, list) else value for key, value in data.items()}
    result["chainage"] = [{"begin": post(entry.begin, 6), "end": post(entry.end, 6)} for entry in sections]
    return result
