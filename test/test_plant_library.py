"""Shipped trains and lines have the data of their sources; wrong files are rejected in one line."""

from pathlib import Path

import numpy as np
import pytest
from plant_trains import train
from refusals import one_line

from plant_sim.library import consist_names, line_names, load_consist, load_line
from plant_sim.si_model import SiModel
from plant_sim.units import Force, Length, Mass, Place, Pressure, Speed, Time


@pytest.mark.parametrize(
    ("name", "vehicles", "mass_t", "length", "units"),
    [
        ("hxd1_c80_105", 106, 10_684, 35.222 + 105 * 12, 1), ("hxd1_c80_210", 212, 21_368, 2 * (35.222 + 105 * 12), 2),
        ("xuzhou_metro_3", 1, 181.2925, 118, 1), ("crh380a_one_mass", 1, 442, 203, 1),
        ("crh380a_three_units", 3, 442, 203, 3), ("crh380a_eight_cars", 8, 442, 203, 6),
        ("freight_five", 5, 400, 400, 5),
    ],
)  # fmt: skip
def test_trains(name: str, vehicles: int, mass_t: float, length: float, units: int) -> None:
    """Numbers, masses and lengths of the papers; every file has a source and runs."""
    consist = load_consist(name)
    assert (len(consist.vehicles), len(consist.power_units)) == (vehicles, units)
    assert consist.mass == pytest.approx(1e3 * mass_t)
    assert consist.length == pytest.approx(length)
    assert consist.name == name
    assert len(consist.source) > 40
    plant = train(consist)
    plant.advance(np.zeros((plant.substeps, units)))


def test_a_vehicle_is_half_of_both_lengths_behind_the_one_before_it() -> None:
    """Breaks if the distance of two centres is the length of one: locomotive 35.222 m, wagons 12 m."""
    assert load_consist("hxd1_c80_105").offsets[:3] == pytest.approx((0.0, 23.611, 35.611))


class Given(SiModel):
    mass: Mass = 0.0
    length: Length = 0.0
    place: Place = 0.0
    speed: Speed = 0.0
    time: Time = 0.0
    force: Force = 0.0
    pressure: Pressure = 0.0


@pytest.mark.parametrize(
    ("key", "value", "si"),
    [
        ("mass_ton", 1, 2000 * 0.45359237), ("mass_lb", 1, 0.45359237), ("length_mi", 1, 1609.344),
        ("length_ft", 5280, 1609.344), ("place_mi", 1, 1609.344), ("place_ft", 1, 0.3048),
        ("speed_mph", 1, 1609.344 / 3600), ("time_h", 1, 3600), ("force_lbf", 1, 0.45359237 * 9.80665),
        ("force_klbf", 1, 1000 * 0.45359237 * 9.80665), ("pressure_psi", 1, 0.45359237 * 9.80665 / 0.0254**2),
        ("pressure_bar", 1, 1e5),
    ],
)  # fmt: skip
def test_suffixes_of_the_united_states_have_their_defined_values(key: str, value: float, si: float) -> None:
    """Breaks if a ton is a long one, a mile is nautical, or a factor is used the wrong way round."""
    assert getattr(Given.model_validate({key: value}), key.partition("_")[0]) == pytest.approx(si, rel=1e-12)


def test_every_shipped_file_is_tested() -> None:
    assert set(consist_names()) == {
        "hxd1_c80_105", "hxd1_c80_210", "xuzhou_metro_3", "crh380a_one_mass", "crh380a_three_units",
        "crh380a_eight_cars", "freight_five",
    }  # fmt: skip
    assert set(line_names()) == {"daqin_section", "xuzhou_metro_test", "highspeed_286km", "level"}
    for name in line_names():
        assert load_line(name).name == name
        assert load_line(name).source


def test_resistance_of_crh380a_is_shared() -> None:
    """Paper 003: f(v) = 2475.2 + 57.28 v + 6.931 v² N, the same total in all three files."""
    for name in ("crh380a_one_mass", "crh380a_three_units", "crh380a_eight_cars"):
        consist = load_consist(name)
        total = np.sum([v.resistance.polynomial(v.mass, consist.gravity) for v in consist.vehicles], axis=0)
        assert total == pytest.approx([2475.2, 57.28, 6.931])
        assert sum(v.traction[0].force for v in consist.vehicles if v.traction) == pytest.approx(240e3)


def test_daqin_section_has_the_described_shape() -> None:
    """Long falling grades and their pieces, undulation, 13 curves, 80 km/h, level before 0 and beyond 45 km."""
    line = load_line("daqin_section")
    at = np.array([entry.at for entry in line.grades] + [line.end])
    grade = 1e3 * np.array([entry.grade for entry in line.grades])
    falling = np.zeros(len(grade), dtype=bool)
    for begin, end in ((19.4e3, 25.3e3), (33.4e3, 36.3e3), (39.3e3, 42.2e3)):
        inside = (at[:-1] >= begin - 1e-6) & (at[1:] <= end + 1e-6)
        falling |= inside
        lengths, steep = np.diff(at)[inside], grade[inside]
        assert lengths.sum() == pytest.approx(end - begin)
        assert lengths.min() >= 560 - 1e-6 and lengths.max() <= 640 + 1e-6
        assert steep.min() >= -11.2 - 1e-9 and steep.max() <= -8.6 + 1e-9
    others = grade[~falling]
    assert (others.min(), others.max()) == pytest.approx((-5.0, 2.0))
    assert (at[-2], grade[-1]) == (pytest.approx(45e3), 0.0) and line.end >= 48e3
    radii = [curve.radius for curve in line.curves]
    assert (len(radii), min(radii), max(radii)) == (13, 600, 1200)
    assert [entry.speed for entry in line.speed_limits] == [pytest.approx(80 / 3.6)]


def test_trigger_finds_four_steep_segments_ahead() -> None:
    """The brake trigger needs 4 pieces below -8 per mille with over 500 m inside the next 2500 m."""
    # Each long falling grade has positions with that, the undulating part has none.
    line = load_line("daqin_section")
    at = np.array([entry.at for entry in line.grades] + [line.end])
    steep = np.array([entry.grade < -8e-3 for entry in line.grades])

    def pieces(place: float) -> int:
        inside = np.minimum(at[1:], place + 2500.0) - np.maximum(at[:-1], place)
        return int((steep & (inside > 500.0)).sum())

    for first, last in ((17.5e3, 22.8e3), (33.0e3, 33.9e3), (38.9e3, 39.7e3)):
        assert max(pieces(place) for place in np.arange(first, last, 50.0)) >= 4
    assert max(pieces(place) for place in np.arange(0.0, 17.0e3, 50.0)) < 4


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("text: [", "line 1"), ("[1, 2]", "keys and values"), ("end_km: 1\ngradez: []", "gradez"), ("", "end"),
        ("end: -5", "end -5 m must be beyond begin 0 m"), ("end: .nan", "end"),
        ("schema: train_ato/line/9\nname: x\nend: 5", "schema"), ("end: 5\nend_km: 1", "the same quantity"),
        ("end: 5\ngrades: [{at: 0, grade: 12}]", "write grade_permille"),
    ],
)  # fmt: skip
def test_bad_line_files(tmp_path: Path, text: str, says: str) -> None:
    """One line with file and key or position; no traceback of YAML or pydantic."""
    file = tmp_path / "own.yaml"
    whole = text.startswith(("text", "[", "schema"))
    file.write_text(text if whole else f"schema: train_ato/line/1\nname: x\n{text}", encoding="utf-8")
    with one_line(r"own\.yaml", says):
        load_line(str(file))


@pytest.mark.parametrize(
    ("old", "new", "names"),
    [
        ("mass_t: 184", "mass_t: -184", "mass"), ("count: 105", "count: 0", "count"),
        ("count: 105", "count: 2000000", "2000001 vehicles, more than 5000"),
        ("default_gear: mt2_mt2", "default_gear: mt3", "mt3"), ("kind: clip", "kind: clap", "draft_gears"),
        ("name: hxd1_c80_105", "nom: hxd1_c80_105", "nom"), ("traction:", "tracktion:", "did you mean 'traction'"),
        ("mass_t: 184", "mass: 184", "write mass_t"),
        ("mass_t: 184", "mass_t: 184\n    adhesive_mass_t: 200", "exceeds the mass"),
        ("{to_kmh: 65, force_kn: 779", "{to_kmh: 4, force_kn: 779", "rising speed"),
        ("{to_kmh: 75, force_kn: 461}", "{to_kmh: 75, force_kn: -461}", "above 0"),
        ("{to_kmh: 5, slope_kn_per_kmh: 92.2}", "{to_kmh: 5, slope_kn_per_kmh: -9}", "above 0"),
        ("transition_stiffness: 60.0e+6", "transition_stiffness: 6.0e+6", "raise it"),
        ("behind: [0]", "behind: [0, 0]", "twice"), ("reduction_kpa: [0, 50]", "reduction_kpa: [10, 50]", "begin at 0"),
        ("braking_factor: [0, 0.17]", "braking_factor: [0, 1.7]", "up to 1"),
        ("braking_factor: [0, 0.17]", "braking_factor: [0.3, 0.17]", "must rise"),
        ("charged_kpa: 600", "charged: 6", "absolute"),
    ],
)  # fmt: skip
def test_bad_consist_files(tmp_path: Path, old: str, new: str, names: str) -> None:
    """Typical mistakes in a train file, each with its own message."""
    from plant_sim import library

    shipped = Path(library.__file__).parent / "data" / "consists" / "hxd1_c80_105.yaml"
    text = shipped.read_text(encoding="utf-8")
    assert old in text
    file = tmp_path / "own.yaml"
    file.write_text(text.replace(old, new), encoding="utf-8")
    with pytest.raises(ValueError, match=r"own\.yaml") as caught:
        load_consist(str(file))
    assert names in str(caught.value)
    assert all(line.startswith(f"{file}: ") for line in str(caught.value).split("\n"))


def test_unknown_names() -> None:
    """Breaks if the message lacks the shipped names or the nearest one."""
    for load, name, text in (
        (load_line, "daquin_section", "did you mean 'daqin_section'"), (load_consist, "no_such_train", "freight_five"),
    ):  # fmt: skip
        with pytest.raises(ValueError, match=text):
            load(name)
