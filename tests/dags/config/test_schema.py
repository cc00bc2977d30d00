"""The JSON schema of the configuration, for editors."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from posegaussian.dags.cli.app import app
from posegaussian.dags.config.schema import configuration_schema
from posegaussian.dags.config.settings import PACKAGED, Settings, load_configuration
from posegaussian.dags.config.yaml_source import load


def test_it_knows_every_key_of_the_packaged_file_and_no_other() -> None:
    schema = configuration_schema()
    packaged = load(PACKAGED).values
    assert set(schema["properties"]) == set(packaged) == {*Settings.model_fields, "sequences"}
    assert schema["additionalProperties"] is False
    for section, values in packaged.items():
        of_section = schema["$defs"].get(schema["properties"][section].get("$ref", "").rpartition("/")[2], {})
        if of_section:
            assert set(of_section["properties"]) == set(values), section
            assert of_section["type"] == ["object", "null"]


def test_a_setting_has_its_meaning_bounds_and_unit_and_nothing_of_our_own() -> None:
    schema = configuration_schema()
    angle = schema["$defs"]["DepthParams"]["properties"]["max_angle"]
    assert angle["exclusiveMaximum"] == 180
    assert angle["description"].endswith("[degrees]")
    assert not [word for word in ("quality_levels", "volatile") if f'"{word}"' in json.dumps(schema)]


def test_settings_of_single_sequences_are_those_that_may_differ() -> None:
    of_one = configuration_schema()["properties"]["sequences"]["additionalProperties"]
    assert "depth" in of_one["properties"]
    assert not {"archive", "run", "partition", "sequences"} & of_one["properties"].keys()


def test_the_command_prints_the_schema_or_the_settings_that_hold(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    printed = CliRunner().invoke(app, ["config", "--schema"])
    assert json.loads(printed.output) == configuration_schema()
    settings = CliRunner().invoke(app, ["config", "--set", "frames.size=960"])
    (tmp_path / "pipeline.yaml").write_text(settings.output)
    assert load_configuration().default == load_configuration(PACKAGED, ["frames.size=960"]).default
