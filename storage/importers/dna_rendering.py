"""DNA-Rendering: two HDF5 files a take, `NAME.smc` with pictures and `NAME_annots.smc` with cameras, masks and joints.

Pictures are `Camera_5mp/<id>/color/<frame>` and `Camera_12mp/<id>/color/<frame>`, JPEG bytes; masks
`Mask/<id>/mask/<frame>`; cameras `Camera_Parameter/<two digits>/{K, D, RT}`, where RT is camera to world, metres,
OpenCV axes; joints `Keypoints_2D/<two digits>` [F, 133, 3], of which the first 17 are COCO's, and
`Keypoints_3D/keypoints3d` [F, 133, 3 or 4], which tell whether the cameras fit. Attributes of the people filmed are not
read. Format: https://github.com/DNA-Rendering/DNA-Rendering, scripts/3DGS/SMCReader.py.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from pydantic import Field

from posegaussian.storage.formats.plain_hdf5 import Hdf5File
from posegaussian.storage.importers.cameras import RawCamera, build_rig, check_principal_point
from posegaussian.storage.importers.common import ImportOptions, entries, folder
from posegaussian.storage.importers.declaration import Importer, Trait
from posegaussian.storage.importers.evidence import Seen, check_points
from posegaussian.storage.importers.filmed import assumed_rate, placed_notes
from posegaussian.storage.importers.masks import mask_gaps
from posegaussian.storage.model.cameras import Rig, to_integer_centres
from posegaussian.storage.model.capture import Capture, SourceFile, Stream
from posegaussian.storage.model.errors import CalibrationError, SourceError
from posegaussian.storage.readers.encoded import encoded_size

GROUPS = ("Camera_5mp", "Camera_12mp")
"""Groups of cameras with pictures; the depth cameras of `Kinect` are left out."""
ANNOTATIONS = "_annots.smc"
FRAME_RATE = 15.0
"""Frames per second."""
BODY = 17
"""Joints of the whole body that are COCO's, the first ones."""
CERTAIN = 0.5
"""Confidence from which a joint in a picture tells about the cameras."""
LOOKED_AT = 3
"""Frames whose joints are projected."""
DIRECTION = "camera to world"


class DnaOptions(ImportOptions):
    """What to take where several fit."""

    take: str | None = Field(None, description="Name of the take, such as 0012_01, where a folder holds several.")


def find(source: Path, options: DnaOptions) -> Capture:
    """Find everything in the folder. Raises SourceError or CalibrationError, each a sentence with the next step."""
    base = folder(source)
    main, annots = _pair(base, options.take)
    own = {int(i): f"{g}/{i}/color" for g in GROUPS for i in main.numbered(g)}
    found = {_name(i): own[i] for i in sorted(own) if main.numbered(own[i])}
    if not found:
        raise SourceError(f"{main.path} holds no pictures Camera_5mp/<id>/color/<frame>; is it the file of a take?")
    notes = [f"camera {_name(i)} has no pictures and is left out" for i in sorted(own) if _name(i) not in found]
    uncalibrated = [n for n in found if not annots.has(f"Camera_Parameter/{n}")]
    notes += [] if options.frame_rate else [assumed_rate(FRAME_RATE)]
    notes += [f"camera {n} has no calibration in {annots.path.name} and is left out" for n in uncalibrated]
    names = options.pick(tuple(n for n in found if n not in uncalibrated))
    if not names:
        raise CalibrationError(f"{annots.path} has no Camera_Parameter of the cameras of {main.path}")
    file, beside = SourceFile.of(main.path), SourceFile.of(annots.path)
    pictures = [_pictures(main, file, found[n]) for n in names]
    cameras = [_camera(annots, n) for n in names]
    for camera, stream in zip(cameras, pictures, strict=True):
        check_principal_point(f"camera {camera.name}", camera.intrinsics, camera.size, stream.size)
    rig = build_rig(cameras, [s.size for s in pictures], half=False)
    placed = placed_notes(rig, "metres", DIRECTION)
    masks, mask_notes = _masks(annots, beside, names, pictures)
    joints, joint_notes = _joints(annots, beside, names, pictures)
    fit = check_points(_seen(annots, names, rig, pictures), DIRECTION)
    return Capture(
        "dna_rendering",
        rig,
        options.frame_rate or FRAME_RATE,
        tuple(pictures),
        masks=masks,
        joints=joints,
        notes=(
            *notes,
            *placed,
            *fit,
            *mask_notes,
            *joint_notes,
            "the file's colour calibration is not applied; exposures are matched by what the pictures show",
        ),
    )


def _name(camera: int) -> str:
    return f"{camera:02d}"


def _pair(base: Path, take: str | None) -> tuple[Hdf5File, Hdf5File]:
    """(pictures, annotations) of the one take, or of the one named. Raises SourceError."""
    takes = [t for t in _takes(base) if take in (None, t)]
    if len(takes) != 1:
        every = ", ".join(_takes(base)[:6]) or "none"
        why = f"option take: there is no {take}" if take else f"{base} holds {len(takes)} takes; choose one with"
        raise SourceError(f"{why}{'' if take else ' --option take=NAME'}; there are {every}")
    annots = base / f"{takes[0]}{ANNOTATIONS}"
    if not annots.exists():
        raise SourceError(f"there is no {annots.name} beside {takes[0]}.smc; download it, it holds cameras and masks")
    return Hdf5File(base / f"{takes[0]}.smc", "take"), Hdf5File(annots, "annotations")


def _takes(base: Path) -> list[str]:
    return [p.stem for p in entries(base) if p.suffix == ".smc" and not p.stem.endswith(("_annots", "_kinect"))]


def _pictures(main: Hdf5File, file: SourceFile, place: str) -> Stream:
    frames = main.numbered(place)
    first = next(iter(frames.values()))
    size = encoded_size(main.encoded(first), f"picture {first} of {main.path}")
    return Stream("hdf5", (file,), tuple(frames), size, {"data": place})


def _camera(annots: Hdf5File, name: str) -> RawCamera:
    place = f"Camera_Parameter/{name}"
    try:
        k, d = annots.numbers(f"{place}/K", [(3, 3)]), annots.numbers(f"{place}/D", [(-1,), (-1, 1), (1, -1)])
        to_world = annots.numbers(f"{place}/RT", [(4, 4), (3, 4)])
    except SourceError as e:
        raise CalibrationError(str(e)) from e
    rotation = to_world[:3, :3].T
    with np.errstate(over="ignore", invalid="ignore"):
        return RawCamera(name, k, d.ravel(), rotation, -rotation @ to_world[:3, 3], None)


def _masks(
    annots: Hdf5File, file: SourceFile, names: Sequence[str], pictures: Sequence[Stream]
) -> tuple[tuple[Stream | None, ...], list[str]]:
    streams: list[Stream | None] = []
    for name, stream in zip(names, pictures, strict=True):
        place = f"Mask/{int(name)}/mask"
        frames = [n for n in annots.numbered(place) if n in set(stream.numbers)]
        if not frames:
            streams.append(None)
            continue
        where = f"{place}/{frames[0]}"
        size = encoded_size(annots.encoded(where), f"mask {where} of {annots.path}")
        if size != tuple(stream.size):
            raise SourceError(
                f"camera {name}: masks are {size[0]}x{size[1]} px, its pictures {stream.size[0]}x{stream.size[1]} px;"
                " masks must have the picture's size"
            )
        streams.append(Stream("hdf5", (file,), tuple(frames), size, {"data": place}))
    if not any(streams):
        return (), []
    if without := [n for n, s in zip(names, streams, strict=True) if s is None]:
        raise SourceError(
            f"cameras {', '.join(without)} have no masks in {annots.path.name} while others have; leave them out with"
            " the option cameras"
        )
    return tuple(streams), mask_gaps(names, streams, pictures)


def _joints(
    annots: Hdf5File, file: SourceFile, names: Sequence[str], pictures: Sequence[Stream]
) -> tuple[tuple[Stream | None, ...], list[str]]:
    streams: list[Stream | None] = []
    for name, stream in zip(names, pictures, strict=True):
        place = f"Keypoints_2D/{name}"
        count = _rows(annots, place)
        frames = [n for n in stream.numbers if n < count]
        options = {"data": place, "joint_set": "coco17", "picked": list(range(BODY))}
        streams.append(Stream("hdf5", (file,), tuple(frames), options=options) if frames else None)
    if not any(streams):
        return (), []
    told = [f"camera {n} has no 2D joints" for n, s in zip(names, streams, strict=True) if s is None]
    return tuple(streams), ["2D joints: the first 17 of Keypoints_2D, joint set coco17", *told]


def _rows(annots: Hdf5File, place: str) -> int:
    """Frames of an array of joints in a picture; 0 where there is none."""
    if not annots.has(place):
        return 0
    shape = annots.shape(place)
    if len(shape) != 3 or shape[1] < BODY or shape[2] != 3:
        raise SourceError(
            f"{annots.path}: {place} has the shape {shape}; [frames, {BODY} or more joints, 3] is expected"
        )
    return shape[0]


def _seen(annots: Hdf5File, names: Sequence[str], rig: Rig, pictures: Sequence[Stream]) -> Iterator[Seen]:
    """The joints in space that pictures saw, in a few frames."""
    place = "Keypoints_3D/keypoints3d"
    if not annots.has(place):
        return
    points = annots.numbers(place, [(-1, -1, 3), (-1, -1, 4)])
    for v, (name, stream) in enumerate(zip(names, pictures, strict=True)):
        count = min(_rows(annots, f"Keypoints_2D/{name}"), len(points))
        frames = [n for n in stream.numbers if n < count]
        for n in frames[:: max(1, len(frames) // LOOKED_AT)][:LOOKED_AT]:
            flat = annots.row(f"Keypoints_2D/{name}", n).astype(np.float64)
            both = min(BODY, len(flat), points.shape[1])
            known = np.isfinite(points[n, :both]).all(axis=1) & np.isfinite(flat[:both]).all(axis=1)
            known &= flat[:both, 2] >= CERTAIN
            if known.any():
                yield Seen(
                    name,
                    to_integer_centres(rig.intrinsics[v]),
                    rig.distortion[v],
                    rig.world_to_camera[v, :3, :3],
                    rig.world_to_camera[v, :3, 3],
                    flat[:both][known, :2],
                    points[n, :both][known, :3],
                    max(stream.size),
                )


IMPORTER = Importer(
    "dna_rendering",
    "NAME.smc and NAME_annots.smc, HDF5 files with pictures, cameras, masks and joints, as DNA-Rendering has them.",
    DnaOptions,
    find,
    (
        Trait(
            "NAME.smc and NAME_annots.smc",
            lambda base: any((base / f"{t}{ANNOTATIONS}").exists() for t in _takes(base)),
        ),
    ),
)
