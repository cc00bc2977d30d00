"""MVHumanNet: 48 cameras around one person in one outfit.

`camera_extrinsics.json` has, by `1_CC32871A004.png`, rotation and translation, world to camera; translations times the
number in `camera_scale.pkl` are metres. `camera_intrinsics.json` is one matrix for all cameras and for pictures of
4096x3000 px, while those that are given away have half of that. `images/CC32871A004/0005_img.jpg` are pictures,
`fmask/CC32871A004/0005_img_fmask.png` masks. Joints and body models are not read. Format:
https://github.com/GAP-LAB-CUHK-SZ/MVHumanNet.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pydantic import Field

from posegaussian.storage.formats.plain_pickle import read_pickle
from posegaussian.storage.importers.cameras import RawCamera, numbers
from posegaussian.storage.importers.common import ImportOptions, Names, folder, numbered, subfolders
from posegaussian.storage.importers.declaration import Importer, Trait
from posegaussian.storage.importers.filmed import DataSet, Filmed, capture_of
from posegaussian.storage.model.capture import Capture
from posegaussian.storage.model.documents import read_json, shortened
from posegaussian.storage.model.errors import CalibrationError, SourceError
from posegaussian.storage.readers.images import PICTURE_SUFFIXES, picture_size

MVHUMANNET = DataSet("mvhumannet", 25.0, "camera_scale.pkl metres", "world to camera")
EXTRINSICS, INTRINSICS, SCALE = "camera_extrinsics.json", "camera_intrinsics.json", "camera_scale.pkl"
FULL = (4096, 3000)
"""(width, height) px that the intrinsics are for."""
WRONG = ("41", 100066)
"""The camera whose extrinsics are wrong from this outfit on
(https://github.com/GAP-LAB-CUHK-SZ/MVHumanNet/issues/23)."""


class MvHumanOptions(ImportOptions):
    """What to leave out."""

    exclude: Names | None = Field(
        None, description="Cameras to leave out; by default camera 41 of outfits from 100066 on, which is wrong there."
    )


def find(source: Path, options: MvHumanOptions) -> Capture:
    """Find everything in the folder. Raises SourceError or CalibrationError, each a sentence with the next step."""
    base = folder(source)
    try:
        extrinsics, intrinsics = read_json(base / EXTRINSICS, "cameras"), read_json(base / INTRINSICS, "cameras")
        scale = read_pickle(base / SCALE, "scale")
    except SourceError as e:
        raise CalibrationError(str(e)) from e
    if not isinstance(scale, float | int) or not 0 < scale < 1e6:
        raise CalibrationError(f"{base / SCALE} holds {shortened(scale)}; one number, metres in a unit, is expected")
    if not isinstance(intrinsics, dict) or "intrinsics" not in intrinsics:
        raise CalibrationError(f"{base / INTRINSICS} has no intrinsics")
    if not isinstance(extrinsics, dict):
        raise CalibrationError(f"{base / EXTRINSICS} holds no cameras")
    found = {f.name: n for f in subfolders(base / "images") if (n := numbered(f, PICTURE_SUFFIXES))}
    if not found:
        raise SourceError(f"no pictures in {base / 'images'}; expected images/CC32871A004/0005_img.jpg")
    keys = {n: _key(n, extrinsics) for n in found}
    left_out, notes = _excluded(base, keys, options.exclude)
    filmed = []
    for name, files in found.items():
        key = keys[name]
        if name in left_out:
            continue
        if key is None:
            notes.append(f"pictures of camera {name} have no calibration and are left out")
            continue
        camera = _camera(name, extrinsics[key], intrinsics, float(scale), picture_size(next(iter(files.values()))))
        filmed.append(Filmed(camera, files, numbered(base / "fmask" / name, PICTURE_SUFFIXES)))
    if not filmed:
        raise CalibrationError(f"{base / EXTRINSICS} names none of the cameras {', '.join(list(found)[:6])} of images")
    width, height = picture_size(next(iter(next(iter(found.values())).values())))
    told = f"intrinsics: for {FULL[0]}x{FULL[1]} px, scaled by {width / FULL[0]:.4g} to pictures of {width}x{height} px"
    unit = f"unit of the cameras: {scale:g} m, as {SCALE} says"
    return capture_of(MVHUMANNET, filmed, options, notes=[unit, told, *notes])


def _key(name: str, extrinsics: dict[str, Any]) -> str | None:
    """What the extrinsics call a folder of pictures: `1_NAME.png`, or NAME alone."""
    return next((k for k in extrinsics if k.removesuffix(".png") == name or _serial(k) == name), None)


def _serial(key: str) -> str:
    return key.removesuffix(".png").partition("_")[2]


def _excluded(base: Path, keys: dict[str, str | None], exclude: tuple[str, ...] | None) -> tuple[set[str], list[str]]:
    """(cameras to leave out, notes)."""
    if exclude is not None:
        for n in exclude:
            if n not in keys:
                raise SourceError(f"option exclude: there is no camera {n}; there are {', '.join(keys)}")
        return set(exclude), []
    number, outfit = WRONG
    if not (base.name.isdecimal() and len(base.name) < 10 and int(base.name) >= outfit):
        return set(), []
    wrong = [n for n, k in keys.items() if k and k.removesuffix(".png").partition("_")[0] == number]
    told = f"its extrinsics are wrong from outfit {outfit} on; the option exclude overrules it"
    return set(wrong), [f"camera {n} is left out: {told}" for n in wrong]


def _camera(name: str, given: Any, intrinsics: dict[str, Any], scale: float, size: tuple[int, int]) -> RawCamera:
    lacking = [k for k in ("rotation", "translation") if not isinstance(given, dict) or k not in given]
    if lacking:
        raise CalibrationError(f"camera {name}: {EXTRINSICS} has no {', '.join(lacking)} of it")
    part = size[0] / FULL[0]
    if abs(size[1] - part * FULL[1]) > 1:
        raise CalibrationError(
            f"camera {name}: pictures are {size[0]}x{size[1]} px, the intrinsics are for {FULL[0]}x{FULL[1]}; only"
            " pictures that show all of that, at any size, are read, and cropped ones have intrinsics of their own"
        )
    k = numbers(intrinsics["intrinsics"], name, "intrinsics", [(3, 3)])
    k[:2, 2] += 0.5  # pixels' corners scale, their centres do not
    k[:2] *= part
    k[:2, 2] -= 0.5
    return RawCamera(
        name,
        k,
        numbers(intrinsics.get("dist") or [], name, "dist", [(-1,)]),
        numbers(given["rotation"], name, "rotation", [(3, 3)]),
        numbers(given["translation"], name, "translation", [(3,)]) * scale,
        None,
    )


IMPORTER = Importer(
    "mvhumannet",
    "camera_extrinsics.json, camera_intrinsics.json, camera_scale.pkl, images and fmask, as MVHumanNet has them.",
    MvHumanOptions,
    find,
    (
        Trait(EXTRINSICS, lambda base: (base / EXTRINSICS).is_file()),
        Trait(SCALE, lambda base: (base / SCALE).is_file()),
    ),
)
