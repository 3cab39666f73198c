"""JSON Schemas of scenario, following, consist, line, journey, learned and recorder files, from their models.

Editors complete and check a file that begins with ``# yaml-language-server: $schema=...``.
"""

from importlib.resources import files
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from msgs_docs.generate.rows import rows_text
from plant_sim.consist import Consist
from plant_sim.line import Line
from train_ato.api.import_csv.layout import RecorderLayout
from train_ato.control.learned_resistance import LearnedResistance
from train_ato.profile.planner.timing_points import JourneyFile
from train_ato.scenario.criteria import Expectation
from train_ato.scenario.following import FollowingSpec
from train_ato.scenario.scenario import Scenario

MODELS: dict[str, type[BaseModel]] = {
    "scenario": Scenario, "following": FollowingSpec, "consist": Consist, "line": Line, "journey": JourneyFile,
    "learned": LearnedResistance, "recorder": RecorderLayout,
}  # fmt: skip


def schema_text(name: str) -> str:
    """Return the JSON Schema of one kind of file."""
    schema = MODELS[name].model_json_schema(by_alias=True)
    schema["$schema"] = "https://json-schema.org/draft/2020-12/schema"
    if name == "scenario":
        # Keys of files only; they are resolved before validation.
        schema["properties"]["base"] = {
            "type": "string",
            "description": "scenario that this one is laid over",
            "examples": ["demo"],
        }
        schema["properties"]["expect"] = _expectation(schema["$defs"])
        schema["properties"]["variants"] = {
            "type": ["object", "null"],
            "description": "overlays by name; null: none",
            "examples": [{"heavy": {"summary": "20 % more mass", "plant": {"mismatch": {"mass_scale": 1.2}}}}],
        }
        # The base of a scenario may have all other keys.
        schema["required"] = ["schema"]
        schema.pop("allOf", None)
        schema["$defs"]["PlantBlock"].pop("required", None)
    return rows_text(schema, 4) + "\n"


def _expectation(definitions: dict[str, Any]) -> dict[str, Any]:
    """Return the schema of ``expect``, whose block is added to the definitions: ``passed`` is short for a block."""
    definitions["Expectation"] = Expectation.model_json_schema()
    forms = [{"const": "passed"}, {"$ref": "#/$defs/Expectation"}]
    text = "expected verdict without changes; every variant states its own"
    return {"anyOf": forms, "description": text, "examples": ["passed"]}


def schema_path(name: str) -> Path:
    """Return the path of a shipped schema."""
    return Path(str(files("train_ato"))) / "scenario" / "schemas" / f"{name}.schema.json"
