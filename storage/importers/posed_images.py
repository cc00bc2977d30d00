"""Cameras out of posed images, as structure from motion leaves them: which images are one camera's, at which instant.

COLMAP and nerfstudio know images, not cameras that film. A rig is what the pipeline needs: cameras that stand still
while time passes. Names tell who took an image (`CAM/000012.jpg`, `000012/CAM.jpg`, `CAM_000012.jpg`, or one picture a
camera), and the poses tell whether that can be: under the right reading every camera stands still. A camera that was
carried through a scene is refused, as people move between its pictures.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from pathlib import PurePosixPath
from typing import NamedTuple

import numpy as np

from posegaussian.storage.formats.joint_files import frame_number
from posegaussian.storage.importers.cameras import RawCamera
from posegaussian.storage.importers.common import natural
from posegaussian.storage.model.cameras import distances
from posegaussian.storage.model.errors import CalibrationError, SourceError

STILL = (0.02, 2.0)
"""What a camera that stands may move between its images: part of the largest distance of two cameras, and degrees.
Structure from motion places every image anew."""
SAME = 1e-9
"""Relative difference below which two calibrations are one."""
WALK = 0.6
"""Median distance from one picture to the next over that of any two, below which numbered pictures are a walk; cameras
chosen at random around a scene have 1."""
FARTHEST = 1e9
"""Units from the origin at which a camera may lie; in metres `model/plausible.py` bounds it."""
RIGID = 1e-3
"""By which R R^T may differ from the identity, as in `model/cameras.py`."""
LONGEST_PART = 250
"""Bytes of the name of a file or folder."""
MOST_CAMERAS = 1000
"""Cameras of a rig."""
FEWEST = 4
"""Pictures that can be a walk; two or three are too few to tell."""


class PosedImage(NamedTuple):
    """One image with its camera at that instant."""

    name: str
    """As the file has it, with `/`; below the folder of the images."""
    intrinsics: np.ndarray
    """[3, 3] px."""
    distortion: np.ndarray
    """[n] OpenCV order."""
    rotation: np.ndarray
    """[3, 3] world to camera, OpenCV axes."""
    centre: np.ndarray
    """[3] place of the camera, units of the file."""
    size: tuple[int, int] | None
    """(width, height) px that the intrinsics are for; None where the file says none."""
    label: str | None = None
    """Name of its camera, where the file says one."""
    number: int | None = None
    """Its instant, where the file says one."""


class Cameras(NamedTuple):
    """Images sorted by camera and instant."""

    by: str
    """How: label, folder, frames, prefix or moment."""
    images: dict[str, dict[int, PosedImage]]
    """{camera: {source frame number: image}}, in natural order."""
    notes: tuple[str, ...]


def checked_name(name: str, where: str) -> str:
    """A path below the images' folder, with `/` and without `./`. Raises SourceError for one that leads elsewhere."""
    path = PurePosixPath(name.replace("\\", "/"))
    windows = len(name) > 1 and name[1] == ":"
    if path.is_absolute() or windows or ".." in path.parts or not path.name or not str(path).isprintable():
        raise SourceError(
            f"{where}: image {name[:200]!r} does not lie below the folder of the images; only paths below it are read,"
            " written relative to it"
        )
    if any(len(part.encode()) > LONGEST_PART for part in path.parts):
        raise SourceError(f"{where}: image {name[:200]!r} has a name of over {LONGEST_PART} bytes, which no file has")
    return str(path)


def instants(images: Sequence[PosedImage], times: Sequence[float | None]) -> tuple[list[PosedImage], list[str]]:
    """(the images with the instants that their times say, notes); as they are where not all have a time.

    A source frame's number is the number in its image's name where these agree with the times, else its rank in time.
    """
    known = [t for t in times if t is not None]
    if len(known) < len(images) or len(set(known)) < 2:
        return list(images), []
    rank = {t: at for at, t in enumerate(sorted(set(known)))}
    for of in (_file_number, _folder_number):
        named = [of(i) for i in images]
        pairs = sorted({(t, n) for t, n in zip(known, named, strict=True) if n is not None})
        ascending = all(a[1] < b[1] for a, b in pairwise(pairs))
        if None not in named and len(pairs) == len(rank) and ascending:
            return [i._replace(number=n) for i, n in zip(images, named, strict=True)], [
                "instants: time and names agree"
            ]
    numbered = [i._replace(number=rank[t]) for i, t in zip(images, known, strict=True)]
    return numbered, [f"instants: {len(rank)} times, counted from 0"]


def sorted_by_camera(images: Sequence[PosedImage], moment: bool | None) -> Cameras:
    """The cameras of posed images. `moment`: every image is another camera's, all of one instant; None: as judged.

    Raises SourceError where images are one camera's that moved, and CalibrationError for a camera with several
    calibrations.
    """
    for i in images:
        error = np.abs(i.rotation @ i.rotation.T - np.eye(3)).max() if (np.abs(i.rotation) < 10).all() else np.inf
        if not error <= RIGID or np.linalg.det(i.rotation) < 0:
            raise CalibrationError(
                f"image {i.name}: its rotation {i.rotation.round(4).tolist()} is off a rigid one, or mirrored; scaled"
                " poses and swapped axes are not read"
            )
        if not (np.abs(i.centre) < FARTHEST).all():
            raise CalibrationError(
                f"image {i.name}: its camera lies at {i.centre.tolist()} units; a place must be finite and within"
                f" {FARTHEST:g} units"
            )
    if moment:
        return _cameras("moment", _one_each(images), images)
    readings: dict[str, dict[str, dict[int, PosedImage]] | None] = {
        "label": _read(images, lambda i: i.label, lambda i: i.number if i.number is not None else _of(_stem(i))),
        "folder": _read(images, lambda i: _parts(i)[0], _file_number),
        "frames": _read(images, _stem, _folder_number),
        "prefix": _read(images, _prefix, lambda i: i.number if i.number is not None else _of(_stem(i))),
    }
    made = {by: found for by, found in readings.items() if found is not None}
    for by, found in made.items():
        if all(len(group) == 1 for group in found.values()):
            continue  # one image a camera tells nothing about time
        if _moving(found) is None:
            return _cameras(by, found, images)
    for by, found in made.items():
        if by in ("label", "folder") and len(found) > 1:
            if all(len(group) == 1 for group in found.values()):
                return _cameras(by, found, images)
            raise SourceError(_moved(found))
    if moment is None:
        if any(i.number is not None for i in images):
            raise SourceError(
                f"the {len(images)} images are of several instants, and read by folder, file or prefix no camera stands"
                f" still: one camera that moves, such as from {images[0].name} to {images[-1].name}. Several cameras"
                " that stand still are needed; where all are of one instant, say --option moment=true"
            )
        _refuse_walk(images)
    return _cameras("moment", _one_each(images), images)


def still_camera(name: str, images: Mapping[int, PosedImage], scale: float) -> RawCamera:
    """The one camera of its images, `scale` metres a unit: the mean of their poses. Raises CalibrationError for
    several calibrations."""
    first = next(iter(images.values()))
    for i in images.values():
        if not (
            _same(first.intrinsics, i.intrinsics) and _same(first.distortion, i.distortion) and first.size == i.size
        ):
            raise CalibrationError(
                f"camera {name}: images {first.name} and {i.name} have different calibrations, but are one camera's;"
                " calibrate with one a camera (COLMAP: --ImageReader.single_camera_per_folder 1)"
            )
    total = np.sum([i.rotation for i in images.values()], axis=0)
    rotation = first.rotation
    if len(images) > 1 and np.isfinite(total).all():
        u, _, vt = np.linalg.svd(total)  # the rotation nearest to the mean (Moakher 2002)
        rotation = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    centre = np.mean([i.centre for i in images.values()], axis=0) * scale
    return RawCamera(name, first.intrinsics, first.distortion, rotation, -rotation @ centre, first.size)


def _same(a: np.ndarray, b: np.ndarray) -> bool:
    if a is b or np.array_equal(a, b, equal_nan=True):
        return True
    return a.shape == b.shape and bool(np.allclose(a, b, rtol=SAME, atol=SAME, equal_nan=True))


def _parts(image: PosedImage) -> tuple[str, str]:
    """(folder, file)."""
    folder, _, file = image.name.rpartition("/")
    return folder, file


def _stem(image: PosedImage) -> str:
    return PurePosixPath(image.name).stem


def _of(text: str) -> int | None:
    return frame_number(text + ".x")


def _file_number(image: PosedImage) -> int | None:
    return image.number if image.number is not None else _of(_stem(image))


def _folder_number(image: PosedImage) -> int | None:
    return image.number if image.number is not None else _of(_parts(image)[0].rpartition("/")[2])


def _prefix(image: PosedImage) -> str:
    return _stem(image).rstrip("0123456789").rstrip("_-. ")


def _read(
    images: Sequence[PosedImage],
    camera: Callable[[PosedImage], str | None],
    number: Callable[[PosedImage], int | None],
) -> dict[str, dict[int, PosedImage]] | None:
    """The images by camera and instant; None where an image lacks one of the two or two images would be one."""
    out: dict[str, dict[int, PosedImage]] = {}
    for i in images:
        name, at = camera(i), number(i)
        if not name or at is None or at in out.setdefault(name, {}):
            return None
        out[name][at] = i
    return {n: dict(sorted(out[n].items())) for n in sorted(out, key=natural)}


def _one_each(images: Sequence[PosedImage]) -> dict[str, dict[int, PosedImage]]:
    """{camera: {0: its one picture}}, named by the files, by the folders where all files are called alike, else by
    both."""
    folders, stems = [_parts(i)[0] for i in images], [_stem(i) for i in images]
    if len(set(stems)) == len(images):
        names = stems
    elif len(set(folders)) == len(images):
        names = list(_shortened(folders).values())
    else:
        names = [i.name.rpartition(".")[0].replace("/", "_") for i in images]
    return {n: {0: i} for n, i in _distinct(names, images).items()}


def _distinct(names: Sequence[str], images: Sequence[PosedImage]) -> dict[str, PosedImage]:
    out: dict[str, PosedImage] = {}
    for n, i in zip(names, images, strict=True):
        if n in out:
            raise SourceError(f"images {out[n].name} and {i.name} would both be camera {n}; rename one")
        out[n] = i
    return out


def _shortened(folders: Sequence[str]) -> dict[str, str]:
    """{folder: the last part of its path where that tells all apart, else all its parts}."""
    last = {f: f.rpartition("/")[2] for f in folders}
    return last if len(set(last.values())) == len(last) else {f: f.replace("/", "_") for f in folders}


def _spread(group: Mapping[int, PosedImage]) -> tuple[float, float]:
    """(distance, degrees) by which the images of a camera differ from the middle one of them, at most."""
    centres, rotations = (np.array([getattr(i, k) for i in group.values()]) for k in ("centre", "rotation"))
    middle = np.median(centres, axis=0)
    cosine = (np.einsum("nij,ij->n", rotations, rotations[0]) - 1) / 2
    return float(np.linalg.norm(centres - middle, axis=1).max()), float(
        np.degrees(np.arccos(np.clip(cosine, -1, 1))).max()
    )


def _extent(found: Mapping[str, Mapping[int, PosedImage]]) -> float:
    """The largest distance between two cameras."""
    middle = np.array([np.median([i.centre for i in g.values()], axis=0) for g in found.values()])
    return float(distances(middle).max(initial=0.0))


def _moving(found: Mapping[str, Mapping[int, PosedImage]]) -> str | None:
    """The camera that moves most among its images, None where all stand still."""
    bound = STILL[0] * _extent(found)
    worst = max(found, key=lambda n: _spread(found[n])[0])
    for n in (worst, *found):
        far, turned = _spread(found[n])
        if not (far <= bound and turned <= STILL[1]):
            return n
    return None


def _moved(found: Mapping[str, Mapping[int, PosedImage]]) -> str:
    name = _moving(found)
    assert name is not None
    far, turned = _spread(found[name])
    return (
        f"camera {_shortened(list(found))[name]} moves: its {len(found[name])} images lie up to {far:.3g} units and"
        f" {turned:.3g} degrees apart, where the cameras lie up to {_extent(found):.3g} units apart. Cameras must stand"
        " still while people move;"
        " where every image is another camera's, all of one instant, say --option moment=true"
    )


def _refuse_walk(images: Sequence[PosedImage]) -> None:
    """Raise SourceError for numbered pictures of one calibration, each taken near the one before."""
    first = images[0]
    prefixes = {_prefix(i) for i in images}
    numbers = [_of(_stem(i)) for i in images]
    alike = all(
        np.array_equal(i.intrinsics, first.intrinsics) and np.array_equal(i.distortion, first.distortion)
        for i in images
    )
    if len(images) < FEWEST or len(prefixes) > 1 or None in numbers or "cam" in first.name.lower() or not alike:
        return
    order = sorted(images, key=lambda i: natural(i.name))
    centres = np.array([i.centre for i in order])
    apart = distances(centres)
    step = float(np.median(np.linalg.norm(np.diff(centres, axis=0), axis=1)))
    if step < WALK * float(np.median(apart)):
        raise SourceError(
            f"the {len(images)} images from {order[0].name} to {order[-1].name} are numbered, have one calibration, and"
            " each was taken near the one before: one camera that was carried through a scene. People move meanwhile,"
            " so several cameras that film at the same time are needed, each with a folder of its own:"
            " images/CAM/000000.jpg. Where every image is another camera's, all of one instant, say --option"
            " moment=true"
        )


def _cameras(by: str, found: dict[str, dict[int, PosedImage]], images: Sequence[PosedImage]) -> Cameras:
    if len(found) > MOST_CAMERAS:
        raise SourceError(f"{len(images)} images of {len(found)} cameras; a rig has at most {MOST_CAMERAS}")
    short = _shortened(list(found))
    firsts = [next(iter(g.values())) for g in found.values()]
    _distinct([short[n] for n in found], firsts)
    sorted_found = {short[n]: found[n] for n in sorted(found, key=natural)}
    told = {
        "label": "cameras: as the file names them",
        "folder": "cameras: one a folder of images",
        "frames": "cameras: by file name; a folder is an instant",
        "prefix": "cameras: by the name of the files without its number",
        "moment": "cameras: one an image, all of one instant",
    }[by]
    notes = [f"{told}; {len(images)} images of {len(found)} cameras"]
    spreads = {n: _spread(g) for n, g in sorted_found.items() if len(g) > 1}
    if spreads:
        far, turned = (max(s[k] for s in spreads.values()) for k in (0, 1))
        notes.append(
            f"every camera stands still: its images' poses differ by up to {far / (_extent(found) or 1):.2g} of the"
            f" largest distance and {turned:.2g} degrees; the mean is taken"
        )
    return Cameras(by, sorted_found, tuple(notes))
