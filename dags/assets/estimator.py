"""From settings to an estimator: whether it can be had, which joints it names, what its models are, and the thing
itself.

Nothing heavy is imported before an estimator is made: a plan asks all but the last.
"""

from __future__ import annotations

from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path

from posegaussian.dags.provenance.code_digest import code_digest
from posegaussian.dags.provenance.once import once
from posegaussian.stages.detection.params import DetectionParams
from posegaussian.stages.estimators.blazepose_files import BLAZEPOSE, model_files
from posegaussian.stages.estimators.description import Description, read_description
from posegaussian.stages.estimators.interface import Estimator
from posegaussian.storage.model.capture import SourceFile
from posegaussian.storage.model.joint_sets import BLAZEPOSE33
from posegaussian.storage.model.spec import digest

KERNELS = {"blazepose": "posegaussian.stages.estimators.blazepose", "onnx": "posegaussian.stages.estimators.onnx"}
"""Module of each estimator: its code counts as that of the stages that ask it."""
RUNNER = "ai_edge_litert"
"""Package that runs BlazePose's models."""


def blazepose_is_here() -> bool:
    """Whether BlazePose can be run: its models are in the cache, and the package that runs them is installed."""
    return model_files() is not None and find_spec(RUNNER) is not None


def named_joint_set(params: DetectionParams) -> str:
    """Id of the joint set of a resolved estimator. Raises SourceError for a description that cannot be read."""
    return BLAZEPOSE33.id if params.estimator == "blazepose" else described(params).joint_set


@lru_cache(maxsize=8)
def _described(model: str, stamp: int) -> Description:
    return read_description(Path(model))


def described(params: DetectionParams) -> Description:
    """The description of the user's model; read again where its file changed. Raises ConfigError, SourceError."""
    assert params.model is not None, "estimator onnx without a model is refused before a plan"
    file = Path(params.model)
    return _described(str(file), file.stat().st_mtime_ns if file.is_file() else 0)


def models_digest(params: DetectionParams) -> str:
    """Digest of the contents of a resolved estimator's models;
    of a user's, with that of whoever finds the people for it."""
    blazepose = [m.sha256 for m in BLAZEPOSE]
    if params.estimator == "blazepose":
        return digest(blazepose)
    found = described(params)
    return digest(
        [found.model_dump(mode="json"), SourceFile.of(found.path).sha256, blazepose if blazepose_is_here() else None]
    )


def estimator_digest(params: DetectionParams) -> str:
    """Digest of what a resolved estimator would find: its models and its code."""
    kernel = KERNELS[params.estimator]
    return digest([models_digest(params), once(("code", kernel), lambda: code_digest(kernel))])


def estimator_of(params: DetectionParams) -> Estimator:
    """A resolved estimator, made once in a process. Raises ConfigError where its models are gone."""
    return _made(params.estimator, params.model, params.rounds, params.zoom)


@lru_cache(maxsize=2)
def _made(estimator: str, model: str | None, rounds: int, zoom: int) -> Estimator:
    from posegaussian.stages.estimators.blazepose import BlazePose

    finder = BlazePose(rounds=rounds, zoom=zoom) if blazepose_is_here() else None
    if estimator == "blazepose":
        return finder or BlazePose()
    from posegaussian.stages.estimators.onnx import OnnxEstimator

    return OnnxEstimator(described(DetectionParams(estimator="onnx", model=model)), finder)
