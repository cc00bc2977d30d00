"""ZJU-MoCap as Neural Body reads it, and the refined `my_*` of Instant-NVR.

`annots.npy` is one pickled dictionary: `cams` with lists `K`, `D`, `R` and `T` (world to camera, millimetres), and
`ims`, a list over frames of {`ims`: paths of all cameras}. A camera's index is its place in these lists, not the
number in its folder's name: 313 and 315 lack `Camera (20)` and `Camera (21)`. Masks lie in `mask_cihp` or `mask` under
the picture's path with `.png`, and hold labels of body parts. Where `ims` is empty, as in some `annots_new.npy`,
cameras are the folders of `images` in order. Format: https://github.com/zju3dv/neuralbody, lib/datasets.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field

from posegaussian.storage.formats.joint_files import frame_number
from posegaussian.storage.formats.plain_pickle import read_object
from posegaussian.storage.importers.cameras import RawCamera, numbers
from posegaussian.storage.importers.common import ImportOptions, folder, numbered, subfolders, with_splits
from posegaussian.storage.importers.declaration import Importer, Trait, or_broken
from posegaussian.storage.importers.filmed import DataSet, Filmed, capture_of
from posegaussian.storage.importers.posed_images import checked_name
from posegaussian.storage.model.capture import Capture
from posegaussian.storage.model.documents import shortened
from posegaussian.storage.model.errors import CalibrationError, SourceError
from posegaussian.storage.readers.images import PICTURE_SUFFIXES

ZJU_MOCAP = DataSet("zju_mocap", 30.0, "millimetres", "world to camera", labels=True)
FILES = ("annots.npy", "annots_new.npy")
MASKS = ("mask_cihp", "mask")
METRES = 1e-3
"""In a unit of the files."""


class ZjuOptions(ImportOptions):
    """What to take where several fit."""

    masks: Literal["auto", "mask_cihp", "mask", "none"] = Field(
        "auto", description="Folder of the masks; auto takes mask_cihp where it is there, else mask."
    )


def find(source: Path, options: ZjuOptions) -> Capture:
    """Find everything in the folder. Raises SourceError or CalibrationError, each a sentence with the next step."""
    base = folder(source)
    path = _file(base)
    if path is None:
        raise SourceError(f"there is no annots.npy in {base}; give the folder of one subject, such as CoreView_377")
    annots = _read(path)
    cameras = _cameras(annots["cams"], path)
    pictures, notes = _listed(annots.get("ims"), cameras, base, path) if annots.get("ims") else _globbed(cameras, base)
    wanted = MASKS if options.masks == "auto" else (options.masks,)
    root = next((base / m for m in wanted if (base / m).is_dir()), None)
    if root is None and options.masks not in ("auto", "none"):
        raise SourceError(f"option masks: there is no folder {base / options.masks}")
    filmed = []
    for camera, (name, files) in zip(cameras, pictures.items(), strict=False):
        if not files:
            notes.append(f"camera {name} has no pictures and is left out")
            continue
        masks = {n: m for n, p in files.items() if root and (m := _mask(root, base, p)) is not None}
        filmed.append(Filmed(camera._replace(name=name), files, masks))
    if not filmed:
        raise SourceError(f"none of the pictures that {path} names is in {base}; unpack them beside it")
    return with_splits(capture_of(ZJU_MOCAP, filmed, options, notes=notes), list(pictures), base.name)


def _file(base: Path) -> Path | None:
    return next((base / f for f in FILES if (base / f).exists()), None)


def _read(path: Path) -> dict[str, Any]:
    """The dictionary of a file. Raises CalibrationError."""
    try:
        found = read_object(path, "annotations")
    except SourceError as e:
        raise CalibrationError(str(e)) from e
    cams = found.get("cams") if isinstance(found, dict) else None
    if not isinstance(cams, dict) or any(k not in cams for k in "KDRT"):
        raise CalibrationError(f"{path} holds no cams with K, D, R and T; is it of another data set?")
    return found


def _cameras(cams: dict[str, Any], path: Path) -> list[RawCamera]:
    """All cameras by their places in the lists, named by these until their folders are known."""
    lists = {k: cams[k] for k in "KDRT"}
    counts = {k: len(v) if isinstance(v, list | np.ndarray) else 0 for k, v in lists.items()}
    if len(set(counts.values())) > 1 or not counts["K"]:
        raise CalibrationError(f"{path}: cams has lists of {counts} cameras; K, D, R and T must have as many")
    out = []
    for i, (k, d, r, t) in enumerate(zip(*lists.values(), strict=True)):
        name = f"at place {i}"
        out.append(
            RawCamera(
                name,
                numbers(k, name, "K", [(3, 3)]),
                numbers(d, name, "D", [(-1,)]),
                numbers(r, name, "R", [(3, 3)]),
                numbers(t, name, "T", [(3,)]) * METRES,
                None,
            )
        )
    return out


def _listed(
    frames: Any, cameras: list[RawCamera], base: Path, path: Path
) -> tuple[dict[str, dict[int, Path]], list[str]]:
    """({camera: pictures that are there}, notes) of `ims`, in the order of the cameras."""
    if not isinstance(frames, list) or not all(isinstance(f, dict) and isinstance(f.get("ims"), list) for f in frames):
        raise CalibrationError(f"{path}: ims must be a list over frames of {{'ims': [paths]}}")
    names: dict[int, str] = {}
    out: dict[str, dict[int, Path]] = {}
    for number, frame in enumerate(frames):
        if len(frame["ims"]) > len(cameras):
            raise CalibrationError(
                f"{path}: frame {number} has {len(frame['ims'])} pictures, and there are {len(cameras)} cameras"
            )
        for i, given in enumerate(frame["ims"]):
            if not isinstance(given, str):
                raise CalibrationError(
                    f"{path}: frame {number} names the picture {shortened(given)}, a path is expected"
                )
            place = base / checked_name(given, f"{path}, frame {number}")
            name = names.setdefault(i, place.parent.name)
            if place.parent.name != name:
                raise CalibrationError(
                    f"{path}: camera at place {i} has pictures in {name} and, frame {number}, in {place.parent.name};"
                    " a camera has one folder"
                )
            if place.is_file():
                out.setdefault(name, {})[number] = place
            else:
                out.setdefault(name, {})
    if len(out) < len(names):
        twice = next(n for n in names.values() if list(names.values()).count(n) > 1)
        raise CalibrationError(f"{path}: two cameras have their pictures in {twice}")
    notes = [
        f"cameras by their places in {path.name}: {', '.join(list(out)[:3])}, ...",
        *(f"the camera at place {i} has no pictures and is left out" for i in range(len(out), len(cameras))),
    ]
    first = next(((n, p) for files in out.values() for n, p in files.items()), None)
    if first and frame_number(first[1]) not in (None, first[0]):
        notes.append(f"frames are counted from 0 as in {path.name}: {first[1].name} is frame {first[0]}")
    if any("kpts2d" in f for f in frames):
        notes.append("kpts2d, joints of the authors' own detector, are not read")
    return out, notes


def _globbed(cameras: list[RawCamera], base: Path) -> tuple[dict[str, dict[int, Path]], list[str]]:
    """The same where the file lists no pictures: cameras are the folders of `images` in order."""
    out = {f.name: numbered(f, PICTURE_SUFFIXES) for f in subfolders(base / "images")}
    if len(out) != len(cameras):
        raise CalibrationError(
            f"the annotations list no pictures, and {base / 'images'} has {len(out)} folders for {len(cameras)}"
            " cameras; cameras go with the folders in order, so all must be there"
        )
    return out, ["the annotations list no pictures: cameras go with the folders of images in order"]


def _mask(root: Path, base: Path, picture: Path) -> Path | None:
    """The mask of a picture: below its own path, or below that without `images`."""
    own = picture.relative_to(base).with_suffix(".png")
    for place in (root / own, root / own.relative_to("images") if own.parts[0] == "images" else root / own):
        if place.is_file():
            return place
    return None


IMPORTER = Importer(
    "zju_mocap",
    "annots.npy, a folder of pictures a camera and masks of body parts, as ZJU-MoCap and its refined my_* have them.",
    ZjuOptions,
    find,
    (
        Trait(
            "annots.npy with cams of K, D, R and T",
            lambda base: (path := _file(base)) is not None and or_broken(lambda: _read(path)),
        ),
        Trait(
            "folders of pictures Camera_... or images",
            lambda base: any(f.name == "images" or f.name.startswith("Camera") for f in subfolders(base)),
            filmed=True,
        ),
    ),
)
