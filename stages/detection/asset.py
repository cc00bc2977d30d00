"""The pose estimator as an asset: whether it can be had, which joints it names, what its models are, and the thing
itself.

Nothing heavy is imported before an estimator is made: a plan asks all but the last.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

from posegaussian.stages.contract.declaration import Asset
from posegaussian.stages.contract.facts import (
    BLAZEPOSE,
    ESTIMATED,
    GIVEN_JOINTS,
    JOINTS2D,
    JOINTS3D,
    SEGMENTED,
    TRACKED,
    Facts,
)
from posegaussian.stages.contract.io import Views
from posegaussian.stages.detection.params import DetectionParams, estimator_choice
from posegaussian.stages.estimators.blazepose_files import BLAZEPOSE as BLAZEPOSE_FILES
from posegaussian.stages.estimators.blazepose_files import model_files
from posegaussian.stages.estimators.description import Description, read_description
from posegaussian.stages.estimators.interface import Estimator
from posegaussian.storage.model.capture import Capture, SourceFile
from posegaussian.storage.model.joint_sets import BLAZEPOSE33
from posegaussian.storage.model.spec import digest

KERNELS = {"blazepose": "posegaussian.stages.estimators.blazepose", "onnx": "posegaussian.stages.estimators.onnx"}
"""Module of each estimator: its code counts as that of the stages that ask it."""
RUNNER = "ai-edge-litert"
"""Package that runs BlazePose's models."""


def blazepose_is_here() -> bool:
    """Whether BlazePose can be run: its models are in the cache, and the package that runs them is installed."""
    if model_files() is None:
        return False
    try:
        distribution(RUNNER)
    except PackageNotFoundError:
        return False
    return True


def told_facts(capture: Capture, views: Views, params: DetectionParams, known: Facts) -> Iterator[str]:
    """Which joints there are, and who finds them."""
    given2d = bool(capture.joints) and any(capture.joints[v] is not None for v in views.sources)
    given3d = capture.joints3d is not None
    found = {name for name, holds in ((GIVEN_JOINTS, given2d or given3d), (BLAZEPOSE, blazepose_is_here())) if holds}
    yield from found
    answer = estimator_choice(params, known | found)[0]
    if answer in KERNELS:
        yield ESTIMATED
    if answer in KERNELS or (given2d and answer == "files"):
        yield JOINTS2D
    if answer in KERNELS or (given2d and answer == "files" and _several(capture, views)):
        yield TRACKED
    if given3d and answer != "none":
        yield JOINTS3D
    if answer == "blazepose":
        yield SEGMENTED


def _several(capture: Capture, views: Views) -> bool:
    """Whether a picture's joints came for more than one person; captures imported before that was noted say no."""
    return any(s is not None and s.options.get("people", 1) > 1 for s in (capture.joints[v] for v in views.sources))


def settled(params: DetectionParams, facts: Facts) -> DetectionParams:
    """The settings with `auto` resolved; BlazePose where it only segments the person whose joints were given."""
    answer = "blazepose" if SEGMENTED in facts and ESTIMATED not in facts else estimator_choice(params, facts)[0]
    return params.model_copy(update={"estimator": answer})


def joint_set(capture: Capture, views: Views, params: DetectionParams, facts: Facts) -> str | None:
    """Id of the joint set of `pose/*`: the estimator's, else of the source views' 2D joints, else of the 3D joints;
    None without any."""
    if ESTIMATED in facts:
        return named_joint_set(settled(params, facts))
    if not facts & {JOINTS2D, JOINTS3D}:
        return None
    streams = [capture.joints[v] for v in views.sources] if JOINTS2D in facts else [capture.joints3d]
    return next((s.options["joint_set"] for s in streams if s is not None), None)


def named_joint_set(params: DetectionParams) -> str:
    """Id of the joint set of a settled estimator. Raises SourceError for a description that cannot be read."""
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
    """Digest of the contents of a settled estimator's models; of a user's, with that of whoever finds the people
    for it."""
    blazepose = [m.sha256 for m in BLAZEPOSE_FILES]
    if params.estimator == "blazepose":
        return digest(blazepose)
    found = described(params)
    return digest(
        [found.model_dump(mode="json"), SourceFile.of(found.path).sha256, blazepose if blazepose_is_here() else None]
    )


def estimator_of(params: DetectionParams) -> Estimator:
    """A settled estimator, made once in a process. Raises ConfigError where its models are gone."""
    return _made(params.estimator, params.model, params.rounds, params.zoom)


@lru_cache(maxsize=2)
def _made(estimator: str, model: str | None, rounds: int, zoom: int) -> Estimator:
    from posegaussian.stages.estimators.blazepose import BlazePose

    finder = BlazePose(rounds=rounds, zoom=zoom) if blazepose_is_here() else None
    if estimator == "blazepose":
        return finder or BlazePose()
    from posegaussian.stages.estimators.onnx import OnnxEstimator

    return OnnxEstimator(described(DetectionParams(estimator="onnx", model=model)), finder)


ESTIMATOR = Asset("estimator", models_digest, estimator_of, settled, lambda params: KERNELS[params.estimator])
"""Who finds people and their joints in pictures."""
