"""Where BlazePose's model files lie, and what they must be:
names, sizes and sha256 of the official mediapipe 0.10.21 wheel."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from posegaussian.storage.model.errors import SourceError
from posegaussian.storage.model.home import at_home, user_cache


@dataclass(frozen=True)
class ModelFile:
    """One file of a model, as it was published."""

    name: str
    """File name in the cache folder."""
    member: str
    """Path inside the wheel."""
    size: int
    """Bytes."""
    sha256: str
    """Hex digest of the content."""


FETCH = "posegaussian models fetch blazepose"
"""The command that brings the files."""

BLAZEPOSE = (
    ModelFile(
        "pose_detection.tflite",
        "mediapipe/modules/pose_detection/pose_detection.tflite",
        2959046,
        "9ba9dd3d42efaaba86b4ff0122b06f29c4122e756b329d89dca1e297fd8f866c",
    ),
    ModelFile(
        "pose_landmark_full.tflite",
        "mediapipe/modules/pose_landmark/pose_landmark_full.tflite",
        6440512,
        "e9a5c5cb17f736fafd4c2ec1da3b3d331d6edbe8a0d32395855aeb2cdfd64b9f",
    ),
    ModelFile(
        "selfie_segmentation.tflite",
        "mediapipe/modules/selfie_segmentation/selfie_segmentation.tflite",
        249505,
        "9ee168ec7c8f2a16c56fe8e1cfbc514974cbbb7e434051b455635f1bd1462f5c",
    ),
)
"""BlazePose's detector and landmark model (full), and the person segmentation that goes with them."""


def cache_folder() -> Path:
    """Folder of fetched models: POSEGAUSSIAN_MODELS, else `posegaussian/models` in XDG_CACHE_HOME, else in the
    platform's folder for caches."""
    if own := os.environ.get("POSEGAUSSIAN_MODELS"):
        return Path(at_home(own))
    return user_cache() / "models"


def blazepose_folder() -> Path:
    """Folder of BlazePose's files."""
    return cache_folder() / "blazepose"


def model_files(folder: Path | None = None) -> dict[str, Path] | None:
    """The three files by name without ending, or None where one is missing or has another size.

    Looks in the cache folder unless another is given. Contents are not read here, see `check_files`.
    """
    place = folder or blazepose_folder()
    files = {Path(m.name).stem: place / m.name for m in BLAZEPOSE}
    return (
        files
        if all(f.is_file() and f.stat().st_size == m.size for f, m in zip(files.values(), BLAZEPOSE, strict=True))
        else None
    )


def check_files(files: Mapping[str, Path]) -> None:
    """Raise SourceError for a file that is not the published one:
    a cache can be spoilt, and results are kept by the models' sha256."""
    for m in BLAZEPOSE:
        file = files[Path(m.name).stem]
        found = hashlib.sha256(file.read_bytes()).hexdigest()
        if found != m.sha256:
            raise SourceError(
                f"{file} has sha256 {found}, the published {m.name} has {m.sha256};"
                f" delete it and bring it again with `{FETCH}`"
            )


def missing_sentence(folder: Path | None = None) -> str:
    """What to do where `model_files` gives None."""
    return (
        f"BlazePose's model files are not in {folder or blazepose_folder()}; bring them with `{FETCH}`, or"
        " `posegaussian models add FILE` where there is no network"
    )
