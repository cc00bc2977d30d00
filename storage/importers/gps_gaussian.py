"""GPS-Gaussian's folders `img`, `mask`, `depth` and `parm`, each with a folder a sample and files a view.

`img/SAMPLE/v.jpg`, `mask/SAMPLE/v.png`, `depth/SAMPLE/v.png` (16 bit, inverse metres times 2^15) and
`parm/SAMPLE/v_intrinsic.npy` [3, 3] and `v_extrinsic.npy` [3, 4], world to camera, OpenCV axes, metres. Of a rendered
sample `SUBJECT_000`, views 0 and 1 are the sources and 2 to 4 the targets; of a subject with several samples, view 0 of
each is a camera of its ring. Samples of cameras that stand still are frames. `v_hr.jpg` is left out. Pixels' centres
lie at (0.5, 0.5), as lib/human_loader.py unprojects them. Format: https://github.com/aipixel/GPS-Gaussian,
prepare_data/render_data.py.
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import Field

from posegaussian.storage.formats.plain_npy import read_numbers
from posegaussian.storage.importers.cameras import DISTORTION, build_rig, check_principal_point
from posegaussian.storage.importers.common import (
    ImportOptions,
    folder,
    natural,
    subfolders,
    with_splits,
)
from posegaussian.storage.importers.declaration import Importer, Trait
from posegaussian.storage.importers.depth_streams import depth_file_streams
from posegaussian.storage.importers.evidence import check_direction
from posegaussian.storage.importers.masks import mask_file_streams
from posegaussian.storage.importers.posed_images import Cameras, PosedImage, sorted_by_camera, still_camera
from posegaussian.storage.importers.posed_pictures import Files, picture_streams
from posegaussian.storage.model.cameras import camera_centre
from posegaussian.storage.model.capture import Capture
from posegaussian.storage.model.errors import CalibrationError, SourceError
from posegaussian.storage.readers.images import picture_size

INVERSE_UNIT = 2.0**-15
"""Inverse metres in a unit of the depth files."""
TARGETS = ("2", "3", "4")
"""Views of a rendered sample that are compared with."""
DIRECTION = "world to camera"


class GpsOptions(ImportOptions):
    """What to take where several fit."""

    sample: str | None = Field(
        None, description="Sample such as 0000_003, or subject such as 0000, whose samples then are one ring."
    )
    pixel_center: Literal["half", "integer"] = Field(
        "half", description="Centre of the first pixel in the intrinsics, 0.5 as the renderer has it, or 0."
    )


def find(source: Path, options: GpsOptions) -> Capture:
    """Find everything in the folder. Raises SourceError or CalibrationError, each a sentence with the next step."""
    base = folder(source)
    samples = [f.name for f in subfolders(base / "img")]
    if not samples:
        raise SourceError(f"no sample in {base / 'img'}; give the folder that holds img, mask and parm, such as val")
    cameras, held_out = _cameras(base, samples, options)
    names = options.pick(tuple(cameras.images))
    groups = {n: cameras.images[n] for n in names}
    files: dict[str, Files] = {n: {k: base / "img" / i.name for k, i in g.items()} for n, g in groups.items()}
    pictures, rate, notes = picture_streams(files, options)
    raw = [still_camera(n, g, 1.0) for n, g in groups.items()]
    rig = build_rig(raw, [s.size for s in pictures], half=options.pixel_center == "half")
    facing = check_direction(names, rig.rotations, rig.centres, DIRECTION)
    beside = {
        kind: [
            {k: p for k, i in g.items() if (p := (base / kind / i.name).with_suffix(".png")).is_file()}
            for g in groups.values()
        ]
        for kind in ("mask", "depth")
    }
    masks, mask_notes = mask_file_streams(names, beside["mask"], pictures)
    depth_maps, depth_notes = depth_file_streams(names, beside["depth"], pictures, INVERSE_UNIT, inverse=True)
    capture = Capture(
        "gps_gaussian",
        rig,
        rate,
        tuple(pictures),
        masks=masks,
        depth_maps=depth_maps,
        held_out=tuple(n for n in names if n in held_out),
        notes=(
            *cameras.notes,
            "unit: metres, as the layout has it",
            *facing,
            *notes,
            *mask_notes,
            *depth_notes,
        ),
    )
    return with_splits(capture, names, "") if held_out == TARGETS else capture


def _cameras(base: Path, samples: list[str], options: GpsOptions) -> tuple[Cameras, tuple[str, ...]]:
    """(cameras, those that only metrics look at). Raises SourceError where several captures fit."""
    wanted = samples if options.sample is None else [s for s in samples if s == options.sample]
    ring = [s for s in samples if options.sample and s.rpartition("_")[0] == options.sample]
    if not wanted and not ring:
        raise SourceError(f"option sample: there is no {options.sample} in {base / 'img'}; there are {_some(samples)}")
    if ring and not wanted:
        own = {(s.rpartition("_")[2], v): i for s in ring for v, i in _views(base, s).items() if v in ("0", *TARGETS)}
        images = {n if v == "0" else f"{n}_{v}": {0: i} for (n, v), i in own.items()}
        _check(list(own.values()))
        told = f"subject {options.sample}: view 0 of {len(ring)} samples is a ring, views 2 to 4 are held out"
        return Cameras("moment", images, (told,)), tuple(n for n in images if "_" in n)
    if len(wanted) == 1:
        views = _views(base, wanted[0])
        _check(list(views.values()))
        held_out = TARGETS if {"0", "1"} <= set(views) and len(views) == 5 else ()
        return Cameras("moment", {v: {0: i} for v, i in views.items()}, (f"sample {wanted[0]}",)), held_out
    everything = [i for s in wanted for i in _views(base, s).values()]
    try:
        found = sorted_by_camera(everything, None)
    except SourceError as e:
        found, why = None, e
    if found is None or found.by != "frames":
        raise SourceError(
            f"{base / 'img'} holds {len(wanted)} samples, whose cameras differ; choose one with --option sample="
            f"{wanted[0]}, or a subject with --option sample={wanted[0].rpartition('_')[0] or wanted[0]}; there are"
            f" {_some(samples)}"
        ) from (why if found is None else None)
    return found, ()


def _check(images: list[PosedImage]) -> None:
    """Raise CalibrationError for what is no pose."""
    sorted_by_camera(images, True)


def _some(samples: list[str]) -> str:
    return ", ".join(samples[:6]) + (f" and {len(samples) - 6} more" if len(samples) > 6 else "")


def _views(base: Path, sample: str) -> dict[str, PosedImage]:
    """{view: image} of a sample."""
    pictures = sorted((base / "img" / sample).glob("*.jpg"), key=lambda p: natural(p.name))
    out = {p.stem: _posed(base, sample, p) for p in pictures if p.stem.isdigit()}
    if not out:
        raise SourceError(f"no picture 0.jpg, 1.jpg, ... in {base / 'img' / sample}")
    return out


def _posed(base: Path, sample: str, picture: Path) -> PosedImage:
    parm = base / "parm" / sample
    where = f"{sample}/{picture.name}"
    try:
        k = read_numbers(parm / f"{picture.stem}_intrinsic.npy", "intrinsics")
        m = read_numbers(parm / f"{picture.stem}_extrinsic.npy", "extrinsics")
    except SourceError as e:
        raise CalibrationError(str(e)) from e
    if k.shape != (3, 3) or m.shape not in ((3, 4), (4, 4)):
        raise CalibrationError(
            f"image {where}: intrinsics {k.shape} and extrinsics {m.shape}; [3, 3] and [3, 4] expected"
        )
    size = picture_size(picture)
    check_principal_point(f"image {where}", k, None, size)
    with np.errstate(over="ignore", invalid="ignore"):
        centre = camera_centre(m)
    return PosedImage(where, k, np.zeros(DISTORTION), m[:3, :3], centre, size)


IMPORTER = Importer(
    "gps_gaussian",
    "img, mask, depth and parm with a folder a sample, as GPS-Gaussian renders and reads them.",
    GpsOptions,
    find,
    (
        Trait("img with a folder a sample", lambda base: bool(subfolders(base / "img")), filmed=True),
        Trait("parm/SAMPLE/0_intrinsic.npy", lambda base: any((base / "parm").glob("*/*_intrinsic.npy"))),
    ),
)
