"""One fault, one sentence, at the place that the file has."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import pytest
from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator

from posegaussian.dags.config.faults import dotted, faults_of, present, unknown_key
from posegaussian.storage.model.errors import ConfigError


class Ball(BaseModel):
    model_config = ConfigDict(extra="forbid")
    kind: Literal["ball"]
    radius: float = Field(gt=0)


class Box(BaseModel):
    kind: Literal["box"]


class Model(BaseModel):
    model_config = ConfigDict(extra="forbid")
    shape: Annotated[Ball | Box, Field(discriminator="kind")] = Box(kind="box")
    count: Literal["auto"] | Annotated[int, Field(ge=0)] = "auto"
    names: dict[Annotated[str, Field(max_length=3)], int] = {}
    sizes: list[int] = []
    widths: tuple[int, int, int, int] = (1, 2, 3, 4)

    @field_validator("sizes")
    @classmethod
    def _even(cls, value: list[int]) -> list[int]:
        if any(s % 2 for s in value):
            raise ValueError("Sizes are even")
        return value


CASES: dict[str, tuple[dict[str, Any], list[str]]] = {
    "bound, in one of several models": (
        {"shape": {"kind": "ball", "radius": 0}},
        ["shape.radius: input should be greater than 0, got 0"],
    ),
    "missing": ({"shape": {"kind": "ball"}}, ["shape.radius: field required"]),
    "unknown": ({"shape": {"kind": "ball", "radius": 1, "radios": 2}}, ["shape.radios: <radios>"]),
    "of two types": (
        {"count": -1},
        [
            "count: input should be 'auto', got -1",
            "count: input should be greater than or equal to 0, got -1",
        ],
    ),
    "key": ({"names": {"long": 1}}, ["names.long: string should have at most 3 characters, got 'long'"]),
    "item": (
        {"sizes": [2, "x"]},
        ["sizes.1: input should be a valid integer, unable to parse string as an integer, got 'x'"],
    ),
    "too few": ({"widths": [8, 16]}, ["widths: 4 values are needed, 2 are given"]),
    "too few by one": ({"widths": [8, 16, 24]}, ["widths: 4 values are needed, 3 are given"]),
    "too few, and wrong": (
        {"widths": ["x"]},
        [
            "widths.0: input should be a valid integer, unable to parse string as an integer, got 'x'",
            "widths: 4 values are needed, 1 is given",
        ],
    ),
    "own sentence": ({"sizes": [3]}, ["sizes: sizes are even"]),
    "several": ({"sizes": 1, "more": 1}, ["sizes: input should be a valid list, got 1", "more: <more>"]),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_a_fault_is_told_at_its_place_in_the_file(case: str) -> None:
    values, sentences = CASES[case]
    with pytest.raises(ValidationError) as error:
        Model.model_validate(values)
    told = faults_of(error.value, values, lambda at: f"<{at[-1]}>")
    assert [f"{dotted(at)}: {what}" for at, what in told] == sentences


def test_an_unknown_key_is_told_with_the_nearest_or_with_all() -> None:
    assert unknown_key("methd", ["method", "pairs"]) == 'unknown key; did you mean "method"?'
    assert unknown_key("x", ["method", "pairs"]) == "unknown key; known are method, pairs"
    assert unknown_key("method", ["pairs"], ["depth.method"]) == 'unknown key; did you mean "depth.method"?'
    assert unknown_key("x", ["blur"], thing="unknown effect") == "unknown effect; known are blur"


def test_a_place_is_there_or_not() -> None:
    values = {"a": [{"b": None}], "c": 1}
    assert present(values, ("a", 0, "b"))
    assert not any(present(values, at) for at in (("a", 1), ("a", "0"), ("c", "d"), ("d",)))


def test_configuration_and_scene_name_the_key_that_the_file_has(tmp_path) -> None:
    from posegaussian.dags.config.settings import load_configuration
    from posegaussian.dags.simulation.simulate import read_scene

    (tmp_path / "own.yaml").write_text("run:\n  gpus: many\n")
    with pytest.raises(ConfigError, match=r"(?m)own\.yaml:2:3 run\.gpus: input should be 'auto', got 'many'$"):
        load_configuration(tmp_path / "own.yaml", folder=tmp_path)
    (tmp_path / "scene.yaml").write_text("rig: {kind: ring, cameras: -1}\n")
    with pytest.raises(
        ConfigError, match=r"(?m)scene\.yaml:1:19 rig\.cameras: input should be greater than or equal to 1, got -1$"
    ):
        read_scene(tmp_path / "scene.yaml")
