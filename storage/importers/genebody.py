"""GeneBody: up to 48 cameras around one person.

`annots.npy` is a pickled dictionary whose `cams` has, by camera, K, D and c2w [4, 4], metres, OpenCV axes;
`image/00/0001.jpg` are pictures, `mask/00/mask0001.png` mattes. `param` and `smpl`, a body model's, are not read: the
former may hold what only torch reads. Format: https://github.com/generalizable-neural-performer/gnr.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from posegaussian.storage.formats.plain_pickle import read_object
from posegaussian.storage.importers.cameras import RawCamera, numbers
from posegaussian.storage.importers.common import ImportOptions, folder, numbered, subfolders, with_splits
from posegaussian.storage.importers.declaration import Importer, Trait, or_broken
from posegaussian.storage.importers.filmed import DataSet, Filmed, capture_of
from posegaussian.storage.model.capture import Capture
from posegaussian.storage.model.errors import CalibrationError, SourceError
from posegaussian.storage.readers.images import PICTURE_SUFFIXES

GENEBODY = DataSet("genebody", 15.0, "metres", "camera to world", rate_told=True)
ANNOTATIONS = "annots.npy"


class GeneBodyOptions(ImportOptions):
    """The layout leaves nothing else to choose."""


def find(source: Path, options: GeneBodyOptions) -> Capture:
    """Find everything in the folder. Raises SourceError or CalibrationError, each a sentence with the next step."""
    base = folder(source)
    path = base / ANNOTATIONS
    cams = _cams(path)
    found = {f.name: n for f in subfolders(base / "image") if (n := numbered(f, PICTURE_SUFFIXES))}
    if not found:
        raise SourceError(f"no pictures in {base / 'image'}; expected image/00/0001.jpg")
    unknown = [n for n in found if n not in cams]
    if len(unknown) == len(found):
        raise CalibrationError(f"{path} names none of the cameras {', '.join(unknown[:6])} of image")
    filmed = [
        Filmed(_camera(name, cams[name], path), files, numbered(base / "mask" / name, PICTURE_SUFFIXES))
        for name, files in found.items()
        if name in cams
    ]
    notes = [f"pictures of camera {n} have no calibration and are left out" for n in unknown]
    notes += [f"camera {n} has no pictures and is left out" for n in cams if n not in found]
    return with_splits(capture_of(GENEBODY, filmed, options, notes=notes), list(found), base.name)


def _cams(path: Path) -> dict[str, Any]:
    """{camera: K, D and c2w}. Raises CalibrationError."""
    try:
        found = read_object(path, "annotations")
    except SourceError as e:
        raise CalibrationError(str(e)) from e
    cams = found.get("cams") if isinstance(found, dict) else None
    if not isinstance(cams, dict) or not cams or not all(isinstance(c, dict) for c in cams.values()):
        raise CalibrationError(f"{path} holds no cams with a camera's K, D and c2w each; is it of another data set?")
    return {str(n): c for n, c in cams.items()}


def _camera(name: str, given: dict[str, Any], path: Path) -> RawCamera:
    if lacking := [k for k in ("K", "D", "c2w") if k not in given]:
        raise CalibrationError(f"{path}: camera {name} has no {', '.join(lacking)}")
    to_world = numbers(given["c2w"], name, "c2w", [(4, 4), (3, 4)])
    rotation = to_world[:3, :3].T
    with np.errstate(over="ignore", invalid="ignore"):
        return RawCamera(
            name,
            numbers(given["K"], name, "K", [(3, 3)]),
            numbers(given["D"], name, "D", [(-1,)]),
            rotation,
            -rotation @ to_world[:3, 3],
            None,
        )


IMPORTER = Importer(
    "genebody",
    "annots.npy with K, D and c2w by camera, image and mask, as GeneBody has them.",
    GeneBodyOptions,
    find,
    (
        Trait(
            "annots.npy with cams by name",
            lambda base: (base / ANNOTATIONS).exists() and or_broken(lambda: _cams(base / ANNOTATIONS)),
        ),
        Trait("image/00", lambda base: bool(subfolders(base / "image")), filmed=True),
    ),
)
