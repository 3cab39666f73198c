"""Units of display: every printed, drawn and exported number in mph, mi, ft, lbf and psi, and as before without it."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from train_ato.cli.main import main
from train_ato.program.display_units import displayed_in, shown_data, shown_table, shown_text
from train_ato.report.quantities import axis_title, style_of


@pytest.mark.parametrize(
    ("text", "us"),
    [  # by hand: 1 mi is 1609.344 m, 1 lbf is 4.44822 N, 1 psi is 6894.76 Pa
        ("speed error 100 km/h rms", "speed error 62.1 mph rms"),  # 100 / 1.609344
        ("couplers -413 ... +505 kN (limits 1125 kN)", "couplers -92800 ... +114000 lbf (limits 252900 lbf)"),
        ("overspeed 2.50 km/h (limit 5) at 3.0 s, km 16.093", "overspeed 1.55 mph (limit 3.11) at 3.0 s, mi 9.9997"),
        ("falls at 19.4-25.3, 33.4 and 42.2 km", "falls at 12.1-15.7, 20.8 and 26.2 mi"),
        ("stopped 1 m short; takeovers 1 (limit 0)", "stopped 3.28 ft short; takeovers 1 (limit 0)"),
        ("105 C80, 2 m/s², 12+345 km 84+500, 500 kPa", "105 C80, 2 m/s², 12+345 km 84+500, 72.5 psi"),
    ],
)
def test_a_quantity_of_a_text_is_shown_in_us_units(text, us):
    """Breaks if a factor is wrong, a range is converted in part, or a number without a unit changes."""
    assert shown_text(text) == text
    with displayed_in("us"):
        assert shown_text(text) == us


def test_keys_and_headings_name_the_unit_of_their_numbers():
    """Breaks if a number changes without its key, or a count or a time is taken for a length."""
    data = {
        "speed_max_kmh": 160.9344, "stops": [{"km": 1.609344, "at_s": 2.0}], "rate_kn_per_s": 4.4482216152605,
        "metric": "stop_error_m", "value": 0.3048, "limit": None, "resistance_n_per_kn": 2, "held": True,
        "at 60 km/h": "a quantity, no heading: shown_text has it",
    }  # fmt: skip
    table = (("metric", "value", "km"), [("speed, rms in km/h", 8.04672, "1.609"), ("ticks", 7, None)])
    assert shown_data(data) == data
    assert shown_table(*table) == ([*table[0]], [[*row] for row in table[1]])
    with displayed_in("us"):
        found = shown_data(data)
        assert list(found) == ["speed_max_mph", "stops", "rate_lbf_per_s", "metric", "value", "limit",
                               "resistance_n_per_kn", "held", "at 60 km/h"]  # fmt: skip
        assert found["speed_max_mph"] == pytest.approx(100.0) and found["rate_lbf_per_s"] == pytest.approx(1e3)
        assert found["stops"] == [{"mi": pytest.approx(1.0), "at_s": 2.0}]
        assert (found["metric"], found["value"], found["limit"]) == ("stop_error_ft", pytest.approx(1.0), None)
        heads, rows = shown_table(*table)
        assert heads == ["metric", "value", "mi"] and rows[1] == ["ticks", 7, None]
        assert rows[0] == ["speed, rms in mph", pytest.approx(5.0), "0.9998"]
        assert axis_title("coupler") == "coupler force in lbf (draft > 0)" and style_of("pipe").unit == "psi"
    with displayed_in("metric"):
        assert shown_data({"speed_m_s": 10.0, "force_n": 2e3}) == {"speed_kmh": 36.0, "force_kn": 2.0}


@pytest.fixture(scope="module")
def run(demo_run):
    return demo_run("duration=15")


def test_commands_print_and_export_us_units(run, tmp_path, capsys):
    """Breaks if a command ignores the option."""
    tables = {}
    for units in ((), ("--units", "us")):
        out = tmp_path / f"tables{len(units)}"
        assert main(["export", str(run), "--csv", "--topics", "train/vehicles", "--out", str(out), *units]) == 0
        head, *rows = csv.reader((out / "train_vehicles.csv").open(newline=""))
        tables[units] = dict(zip(head, rows[-1], strict=True))
    si, us = tables.values()
    assert float(us["vehicle_0_speed_mph"]) == pytest.approx(float(si["vehicle_0_speed_m_s"]) / 0.44704)
    assert float(us["vehicle_0_position_ft"]) == pytest.approx(float(si["vehicle_0_position_m"]) / 0.3048)
    assert us["time_s"] == si["time_s"] and len(us) == len(si)
    capsys.readouterr()
    plan = ["plan", "xuzhou_metro_test", "xuzhou_metro_3", "--json"]
    found = [json.loads(capsys.readouterr().out) for extra in ((), ("--units", "us")) if main([*plan, *extra]) == 0]
    assert found[1]["distance_ft"] == pytest.approx(found[0]["distance_m"] / 0.3048)
    assert found[1]["running_time_s"] == found[0]["running_time_s"]


def test_braking_curves_have_one_system_of_units(tmp_path, capsys):
    """Breaks if a table, a deviation or a release speed keeps metres, or the head of its column does."""
    case = str(Path(__file__).parent / "data" / "etcs_braking_cases.json")

    def printed(*more: str) -> str:
        assert main(["curves", case, *more]) == 0
        return capsys.readouterr().out

    si, us = (json.loads(printed("--deviation", "--json", *units)) for units in ((), ("--units", "us")))
    for name, entry in si.items():
        for curve, rows in entry["curves"].items():
            shown = np.array(us[name]["curves"][curve])
            assert shown == pytest.approx(np.array(rows) / (1.609344, 0.3048), abs=1e-9)
        assert us[name]["deviation_ft"] == pytest.approx(
            {curve: each / 0.3048 for curve, each in entry["deviation_m"].items() if each is not None}
        )
    text = printed("--units", "us", "--out", str(tmp_path / "curves.svg"))
    assert "before the target in ft" in text and "   mph" in text and " m" not in text.replace(" mph", "")
    drawn = (tmp_path / "curves.svg").read_text(encoding="utf-8")
    assert "speed in mph" in drawn and "target in ft" in drawn


def test_a_report_has_one_system_of_units(run, tmp_path):
    """Breaks if a part of the page keeps km/h, kN or kPa."""
    page = tmp_path / "page.html"
    assert main(["report", str(run), "--out", str(page), "--units", "us"]) == 0
    text = page.read_text(encoding="utf-8").partition("<header>")[2]
    assert "mph" in text and "lbf" in text
    assert not [unit for unit in (" km/h", " kN", " kPa", '"km/h"', '"kN"', '"kPa"') if unit in text]
