"""Settings of the detection stage, and how `estimator: auto` is resolved."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, field_validator

from posegaussian.stages.contract.declaration import Params, setting
from posegaussian.stages.contract.facts import BLAZEPOSE, GIVEN_JOINTS, Facts
from posegaussian.stages.estimators.blazepose_files import FETCH

Answer = Literal["files", "blazepose", "onnx", "none"]
ADDED = f"`{FETCH}` adds it"
"""What to do where BlazePose is missing."""


class DetectionParams(Params):
    """Who finds the people, and which of them count."""

    estimator: Literal["auto", "files", "blazepose", "onnx", "none"] = setting(
        "auto", "Where joints come from: files of the capture, BlazePose, a model of yours, or nowhere."
    )
    model: str | None = setting(None, "YAML file that describes a heatmap or SimCC model in ONNX; for estimator: onnx.")
    zoom: int = setting(
        1,
        "Where BlazePose's detector looks: 0 the whole picture; 1 also squares of it where it sees nobody; 2 always"
        " these and smaller ones, for people small in the picture.",
        quality_levels=[0, 1, 2],
        ge=0,
        le=2,
    )
    rounds: int = setting(
        1,
        "Most times BlazePose reads landmarks again in the region they themselves give.",
        quality_levels=[0, 1, 3],
        ge=0,
        le=8,
    )
    people: int = setting(3, "People kept a picture, the clearest first.", ge=1, le=16)
    box: dict[str, Annotated[list[float], Field(min_length=4, max_length=4)]] = setting(
        {},
        "Per camera [left, top, right, bottom] in captured px: only people whose joints' middle lies inside count.",
        unit="px",
    )

    @field_validator("box")
    @classmethod
    def _boxes_have_an_inside(cls, boxes: dict[str, list[float]]) -> dict[str, list[float]]:
        for name, (left, top, right, bottom) in boxes.items():
            if left >= right or top >= bottom:
                raise ValueError(
                    f"the box of {name} is [left, top, right, bottom]"
                    f" with left < right and top < bottom, got {boxes[name]}"
                )
        return boxes


def estimator_choice(params: DetectionParams, facts: Facts) -> tuple[Answer, str]:
    """The estimator and one sentence that says why: given joints before estimated ones; facts are the capture's."""
    if params.estimator != "auto":
        return params.estimator, f"detection.estimator is {params.estimator}"
    if GIVEN_JOINTS in facts:
        return "files", "joints came with the capture"
    if BLAZEPOSE in facts:
        return "blazepose", "no joints came with the capture, and the models of BlazePose are here"
    return "none", f"no joints came with the capture, and BlazePose is not here: {ADDED}"


def refusal(params: DetectionParams, facts: Facts) -> str | None:
    """Why an estimator that was asked for cannot be had, with what to do."""
    if params.estimator == "files" and GIVEN_JOINTS not in facts:
        return "detection.estimator is files, but no joints came with the capture; import them with it, or use auto"
    if params.estimator == "blazepose" and BLAZEPOSE not in facts:
        return (
            "detection.estimator is blazepose, but its models or ai-edge-litert, which runs them, are not here:"
            f" {ADDED}; or use files"
        )
    if params.estimator == "onnx" and params.model is None:
        return (
            "detection.estimator is onnx, but detection.model names no file; give the YAML that describes your model"
            " (docs/guide/pose.md)"
        )
    return None
