"""The JSON schema of a configuration, for editors: keys, what they mean, their bounds and defaults."""

from __future__ import annotations

from typing import Any

from posegaussian.dags.config.settings import GLOBAL, Settings

OWN = ("volatile", "quality_levels")
"""Keys of our declarations that mean nothing to an editor."""


def configuration_schema() -> dict[str, Any]:
    """The schema of a file that may be partial, as `--config` takes it, `sequences` included."""
    schema: dict[str, Any] = _cleaned(Settings.model_json_schema())
    own = {key: value for key, value in schema["properties"].items() if key not in GLOBAL}
    overrides = {"type": ["object", "null"], "properties": own, "additionalProperties": False}
    schema["properties"]["sequences"] = {
        "type": "object",
        "description": "GLOB: settings of the sequences that it matches, laid over all others.",
        "additionalProperties": overrides,
    }
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **schema,
        "title": "PoseGaussian's pipeline.yaml",
    }


def _cleaned(value: Any) -> Any:
    """Without our own keys and the titles, which repeat the names; the unit is said in the description. A section whose
    keys are all commented out reads as null, which changes nothing."""
    if isinstance(value, list):
        return [_cleaned(v) for v in value]
    if not isinstance(value, dict):
        return value
    unit = value.get("unit")
    dropped = OWN if isinstance(unit, str) else ()
    out = {k: _cleaned(v) for k, v in value.items() if k not in dropped and not (k == "title" and isinstance(v, str))}
    if isinstance(unit, str):
        del out["unit"]
        if unit != "1":
            out["description"] = f"{out['description']} [{unit}]"
    if out.get("type") == "object" and isinstance(out.get("properties"), dict):
        out["type"] = ["object", "null"]
    return out
