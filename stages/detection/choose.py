"""From settings to an estimator: whether it can be had, which joints it names, what its models are, and the thing itself.

Nothing heavy is imported before an estimator is made: a plan asks all but the last.
"""

from __future__ import annotations

from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from stages.detection.estimator import Estimator
from stages.detection.models import BLAZEPOSE, model_files
from stages.detection.params import DetectionParams
from storage.capture import SourceFile
from storage.spec import digest

KERNELS = {"blazepose": "stages.detection.blazepose", "onnx": "stages.detection.onnx"}
"""Module of each estimator: its code counts as that of the stages that ask it."""
RUNNER = "ai_edge_litert"
"""Package that runs BlazePose's models."""


def blazepose_is_here() -> bool:
    """Whether BlazePose can be run: its models are in the cache, and the package that runs them is installed."""
    return model_files() is not None and find_spec(RUNNER) is not None


def named_joint_set(params: DetectionParams) -> str:
    """Id of the joint set of a resolved estimator. Raises SourceError for a description that cannot be read."""
    return "blazepose33" if params.estimator == "blazepose" else described(params).joint_set


def described(params: DetectionParams) -> Any:
    """The description of the user's model."""
    from stages.detection.description import Description

    assert params.model is not None, "estimator onnx without a model is refused before a plan"
    return Description.read(Path(params.model).expanduser())


def models_digest(params: DetectionParams) -> str:
    """Digest of the contents of a resolved estimator's models."""
    if params.estimator == "blazepose":
        return digest([m.sha256 for m in BLAZEPOSE])
    found = described(params)
    return digest([found.model_dump(mode="json"), SourceFile.of(found.path).sha256])


def estimator_of(params: DetectionParams) -> Estimator:
    """A resolved estimator, made once in a process. Raises ConfigError where its models are gone."""
    return _made(params.estimator, params.model)


@lru_cache(maxsize=2)
def _made(estimator: str, model: str | None) -> Estimator:
    if estimator == "onnx":
        from stages.detection.onnx import load

        return load(described(DetectionParams(estimator="onnx", model=model)), model_files())
    from stages.detection.blazepose import BlazePose

    return BlazePose()
