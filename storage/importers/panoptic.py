"""CMU Panoptic: the HD cameras of its dome.

`calibration_NAME.json` lists cameras of all kinds with K, distCoef, R and t, world to camera, centimetres. HD cameras
`00_XX` have `hdVideos/hd_00_XX.mp4` or `hdImgs/00_XX/00_XX_00000000.jpg`, at 29.97 frames/s; VGA cameras and Kinects
run at other rates, so that their frame n is another instant, and are left out. `hdPose3d_stage1_coco19/` has joints in
space of every HD frame; those of one body are taken. Format: https://github.com/CMU-Perceptual-Computing-Lab/panoptic-toolbox.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import Field

from posegaussian.storage.formats.body_scenes import read_bodies
from posegaussian.storage.importers.cameras import MOST_SKEW, RawCamera, moved_by_skew, numbers
from posegaussian.storage.importers.common import ImportOptions, file_stream, folder, numbered, subfolders, videos_in
from posegaussian.storage.importers.declaration import Importer, Trait, or_broken
from posegaussian.storage.importers.filmed import DataSet, Filmed, capture_of
from posegaussian.storage.importers.posed_pictures import Files
from posegaussian.storage.model.cameras import Rig
from posegaussian.storage.model.capture import Capture, Stream
from posegaussian.storage.model.documents import read_json, shortened
from posegaussian.storage.model.errors import CalibrationError, SourceError
from posegaussian.storage.model.joint_sets import PANOPTIC19
from posegaussian.storage.readers.images import PICTURE_SUFFIXES

PANOPTIC = DataSet("panoptic", 29.97, "centimetres", "world to camera", rate_told=True)
METRES = 1e-2
"""In a unit of the files."""
JOINTS = "hdPose3d_stage1_coco19"


class PanopticOptions(ImportOptions):
    """Whose joints to take."""

    person: int | None = Field(
        None, description="Id of the body whose joints in space are taken; by default the one in most frames."
    )


def find(source: Path, options: PanopticOptions) -> Capture:
    """Find everything in the folder. Raises SourceError or CalibrationError, each a sentence with the next step."""
    base = folder(source)
    path = _calibration(base)
    found = _filmed_files(base)
    if not found:
        raise SourceError(
            f"no pictures of HD cameras in {base}: expected hdVideos/hd_00_00.mp4 or hdImgs/00_00/00_00_00000000.jpg"
        )
    cameras, notes = _cameras(path, found)
    filmed = [Filmed(cameras[n], files) for n, files in found.items() if n in cameras]
    if not filmed:
        raise CalibrationError(f"{path} has none of the HD cameras {', '.join(list(found)[:6])}")
    capture = capture_of(PANOPTIC, filmed, options, notes=notes)
    joints3d, told = _joints(base, capture, options.person)
    return replace(capture, joints3d=joints3d, notes=(*capture.notes, *told))


def _calibration(base: Path) -> Path:
    paths = sorted(base.glob("calibration_*.json"))
    if len(paths) != 1:
        raise CalibrationError(
            f"{base} holds {len(paths)} files calibration_NAME.json; give the folder of one sequence, which has one"
        )
    return paths[0]


def _filmed_files(base: Path) -> dict[str, Files]:
    """{camera: its pictures or video}."""
    images = {f.name: n for f in subfolders(base / "hdImgs") if (n := numbered(f, PICTURE_SUFFIXES))}
    return dict(images) or {n.removeprefix("hd_"): p for n, p in videos_in(base / "hdVideos").items()}


def _joints(base: Path, capture: Capture, person: int | None) -> tuple[Stream | None, list[str]]:
    """(joints in space of one body, notes). Raises SourceError for a person that is in no frame, and CalibrationError
    where no camera sees the joints."""
    folder_ = next((f for f in (base / JOINTS, base / JOINTS / "hd") if any(f.glob("body3DScene_*.json"))), None)
    if folder_ is None:
        return None, [f"there are no joints in space, {JOINTS}/body3DScene_00000000.json"]
    files = numbered(folder_, (".json",))
    files = {n: p for n, p in files.items() if n in set(capture.numbers.tolist())}
    bodies = {n: read_bodies(p) for n, p in files.items()}
    count = Counter(who for found in bodies.values() for who in found)
    if not count:
        return None, ["the joints in space hold nobody in these frames"]
    if person is not None and person not in count:
        raise SourceError(f"option person: no body has the id {person}; there are {', '.join(map(str, sorted(count)))}")
    chosen = min(count, key=lambda who: (-count[who], who)) if person is None else person
    points = np.concatenate([f[chosen][f[chosen][:, 3] > 0, :3] for f in bodies.values() if chosen in f])
    seen = _seeing(capture.rig, points)
    if not seen:
        raise CalibrationError(
            f"{folder_}: joints in space of body {chosen} lie in no camera's picture; are they of this calibration, in"
            " centimetres?"
        )
    others = f", ids {', '.join(str(w) for w in sorted(count) if w != chosen)} are left out" if len(count) > 1 else ""
    lacking = len(files) - count[chosen]
    gaps = f"; {lacking} frames lack it, where the same person may have another id" if lacking else ""
    stream = file_stream("bodies", files, joint_set=PANOPTIC19.id, person=chosen)
    return stream, [
        f"joints in space: body {chosen} of {len(count)}{others}, and {seen} of {len(capture.rig)} cameras see it{gaps}"
    ]


def _seeing(rig: Rig, points: np.ndarray) -> int:
    """Cameras in whose picture most of the points [n, 3] lie; distortion is too little to matter."""
    seen = 0
    for k, m, size in zip(rig.intrinsics, rig.world_to_camera, rig.size, strict=True):
        local = points @ m[:3, :3].T + m[:3, 3]
        ahead = local[local[:, 2] > 0]
        landed = (ahead @ k.T)[:, :2] / ahead[:, 2:]
        seen += int(((landed > 0) & (landed < size)).all(axis=1).sum() * 2 > len(points))
    return seen


def _cameras(path: Path, wanted: dict[str, Files]) -> tuple[dict[str, RawCamera], list[str]]:
    """({name: HD camera that has pictures}, notes)."""
    try:
        data = read_json(path, "calibration")
    except SourceError as e:
        raise CalibrationError(str(e)) from e
    listed = data.get("cameras") if isinstance(data, dict) else None
    if not isinstance(listed, list) or not all(isinstance(c, dict) for c in listed):
        raise CalibrationError(f"{path} has no list of cameras")
    out: dict[str, RawCamera] = {}
    notes = []
    without = 0
    for given in listed:
        name = given.get("name")
        if given.get("type") != "hd" or not isinstance(name, str):
            continue
        if name in out:
            raise CalibrationError(f"{path}: camera {name} is there twice")
        if name not in wanted:
            without += 1
            continue
        camera = _camera(name, given, path)
        if (moved := moved_by_skew(camera.intrinsics, given["resolution"])) > MOST_SKEW:
            notes.append(
                f"camera {name} is left out: its skew {camera.intrinsics[0, 1]:g} px would move the picture's edge by"
                f" {moved:.1f} px"
            )
            continue
        out[name] = camera
    others = sum(c.get("type") != "hd" for c in listed)
    if others:
        notes.append(f"{others} cameras of other kinds run at other rates and are left out")
    if without:
        notes.append(f"{without} HD cameras have no pictures and are left out")
    uncalibrated = [n for n in wanted if n not in [c.get("name") for c in listed]]
    return out, notes + [f"pictures of camera {n} have no calibration and are left out" for n in uncalibrated]


def _camera(name: str, given: dict[str, Any], path: Path) -> RawCamera:
    if lacking := [k for k in ("K", "distCoef", "R", "t", "resolution") if k not in given]:
        raise CalibrationError(f"{path}: camera {name} has no {', '.join(lacking)}")
    size = given["resolution"]
    if not isinstance(size, list) or len(size) != 2 or not all(type(n) is int for n in size):
        raise CalibrationError(f"camera {name}: resolution {shortened(size)} is not [width, height] px")
    intrinsics = numbers(given["K"], name, "K", [(3, 3)])
    if not np.isfinite(intrinsics).all() or intrinsics[1, 1] == 0:
        raise CalibrationError(f"camera {name}: K {intrinsics.tolist()} is no matrix of intrinsics")
    return RawCamera(
        name,
        intrinsics,
        numbers(given["distCoef"], name, "distCoef", [(-1,)]),
        numbers(given["R"], name, "R", [(3, 3)]),
        numbers(given["t"], name, "t", [(3,)]) * METRES,
        (size[0], size[1]),
    )


IMPORTER = Importer(
    "panoptic",
    "calibration_NAME.json and hdVideos or hdImgs of one sequence, as CMU Panoptic has them.",
    PanopticOptions,
    find,
    (
        Trait("calibration_NAME.json", lambda base: any(base.glob("calibration_*.json"))),
        Trait(
            "hdVideos/hd_00_00.mp4 or hdImgs/00_00",
            lambda base: or_broken(lambda: _filmed_files(base)),
            filmed=True,
        ),
    ),
)
