"""Key `base` of a scenario: variants and files of the base."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

import train_ato as ta
from train_ato.scenario.scenario import load_scenario, raw_scenario


def overlay(folder: Path, base: str, more: str = "") -> str:
    path = folder / "mine.yaml"
    path.write_text(f"schema: train_ato/scenario/1\nbase: {base}\nname: mine\n{more}")
    return str(path)


def test_base_can_be_a_variant(tmp_path: Path) -> None:
    """Breaks if the variant of a base is ignored, or if the variants of the base are lost."""
    name = overlay(tmp_path, "xuzhou_metro:slower", "laws: {pid: {kp: 1.0}}\n")
    scenario = load_scenario(name)[0]
    assert scenario.plant.lag == 0.5 and scenario.laws["pid"] == {"kp": 1.0, "ki": 0.43, "integral_limit": 0.7}
    assert load_scenario(f"{name}:ideal")[0].plant.lag == 0.0


def test_base_with_an_unknown_variant_is_refused(tmp_path: Path) -> None:
    """Breaks if a misspelt variant is ignored."""
    with pytest.raises(ValueError, match="no variant 'slow'"):
        load_scenario(overlay(tmp_path, "xuzhou_metro:slow"))


def test_base_can_have_files_in_another_folder(tmp_path: Path) -> None:
    """Breaks if the profile file of a base is searched beside the overlay."""
    run = ta.run(overlay(tmp_path, "daqin_heavy_haul"), set={"duration": 1})
    assert run.metrics["ticks"] == 10


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("demo", {}),
        ("xuzhou_metro:slower", {"duration": 20, "laws.smc.ks": 0.1}),
        ("daqin_heavy_haul:tuned", {"plant": {"consist": "hxd1_c80_105", "line": "level"}}),
    ],
)
def test_overlay_of_a_choice_has_the_same_content(name: str, changes: dict[str, object], tmp_path: Path) -> None:
    """Breaks if a change of `with_` is lost in the overlay, also one that replaces a whole block."""
    choice = ta.scenario(name).with_(changes)
    path = tmp_path / "mine.yaml"
    path.write_text(yaml.safe_dump(choice.as_overlay))
    found = ta.scenario(str(path)).checked
    expected = choice.checked
    assert found.model_copy(update={"name": "", "profile": None}) == expected.model_copy(
        update={"name": "", "profile": None}
    )
    assert raw_scenario(str(path))[1]["profile"].keys() == raw_scenario(name)[1]["profile"].keys()
