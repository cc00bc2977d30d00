"""Where masks lie: the files of a camera's, and what a capture without masks has in their place."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterable
from pathlib import Path

from posegaussian.storage.importers.common import all_below, entries, numbered, shown, subfolders
from posegaussian.storage.importers.posed_pictures import Files
from posegaussian.storage.model.capture import PER_VIEW, Capture, Stream
from posegaussian.storage.model.errors import SourceError
from posegaussian.storage.readers import images
from posegaussian.storage.readers.video import VIDEO_SUFFIXES

_PLACE = "masks"
"""Folder in which masks are looked for."""
_MEANT = (_PLACE, "mask")
"""Folders that are meant for masks, in small letters."""
_NO_MASKS = "there are no masks: a run cuts the person out where it can (frames.matte)"
_COUNTED = re.compile(r"(.*?([0-9]+)[^0-9]+)([0-9]+)[^0-9]*")
"""A file's name without its ending that has two numbers at least: (all before the last, the last but one, the last)."""


def masks_in(folder: Path) -> dict[int, Path]:
    """{source frame number: mask} of one folder. Raises SourceError for a number twice or none, and for several masks a
    frame, which have the frame's number before a shorter one of their own."""
    of_frame: dict[str, list[Path]] = {}
    frames: dict[str, set[str]] = {}
    for path in _pictures(folder):
        named = _COUNTED.fullmatch(path.stem)
        if named and len(named[2]) > len(named[3]):
            of_frame.setdefault(named[1], []).append(path)
            frames.setdefault(named[3], set()).add(named[1])
    several = next((paths for paths in of_frame.values() if len(paths) > 1), None)
    if several and any(len(of) > 1 for of in frames.values()):
        raise _several(several)
    return numbered(folder, images.PICTURE_SUFFIXES)


def check_one_a_frame(masks: Iterable[Path], pictures: Stream) -> None:
    """Raise SourceError where a camera has one picture and several masks that have its name before a number of their
    own."""
    if pictures.kind != "images" or len(pictures.files) > 1:
        return
    picture = re.escape(Path(pictures.files[0].path).stem)
    several = [p for p in masks if re.fullmatch(picture + "[^0-9]+[0-9]+", p.stem)]
    if len(several) > 1:
        raise _several(several)


def _several(masks: list[Path]) -> SourceError:
    """The refusal of these masks of one frame."""
    names = shlex.join(p.name for p in masks)
    return SourceError(
        f"{masks[0].parent}: {', '.join(p.name for p in masks[:2])} look like several masks of one frame, such as one a"
        " person or part, and the last number of a name is read as the frame's; make one mask a frame, named by the"
        " frame's number alone, white wherever the subject is: leave other people's out and merge the rest, such as"
        f" convert {names} -evaluate-sequence max FRAME.png"
    )


def masks_beside(root: Path, images_root: Path, camera: str, pictures: Files) -> dict[int, Path]:
    """{source frame number: mask} below `root` of a camera's pictures: by their names below `images_root`, with `.png`
    appended or in place of their ending, else `root/CAMERA/<number>.png`, as of videos. Raises SourceError."""
    out = {}
    for n, path in pictures.items() if isinstance(pictures, dict) else ():
        name = path.relative_to(images_root if path.is_relative_to(images_root) else root.parent)
        for candidate in (root / f"{name}.png", (root / name).with_suffix(".png")):
            if candidate.is_file():
                out[n] = candidate
                break
    return out or masks_in(root / camera)


def without_masks(base: Path, capture: Capture, masked: bool) -> list[str]:
    """The sentences about a capture that has no masks, and about files in its folder that may be some; with `masked`
    its layout reads `masks/CAM/000000.png`."""
    notes = [_NO_MASKS]
    others = _of_cameras(base, capture) if masked else []
    if others:
        notes.append(
            f"{shown(base, others)} {'holds' if len(others) == 1 else 'hold'} pictures in folders of cameras' names and"
            f" {'is' if len(others) == 1 else 'are'} not read: masks are read from {_PLACE}; if"
            f" {'it holds' if len(others) == 1 else 'one holds'} masks, the subject white, rename it and import again:"
            f" mv {shlex.quote(str(others[0]))} {shlex.quote(str(base / _PLACE))}"
        )
    for place in subfolders(base):
        if place.name.lower() in _MEANT and place not in others:
            notes += _unread(base, place, capture.layout, masked)
    return notes


def _of_cameras(base: Path, capture: Capture) -> list[Path]:
    """Folders in a capture's folder, none of whose files it has, with pictures in folders of its cameras' names."""
    streams = (s for kind in PER_VIEW for s in getattr(capture, kind) if s is not None)
    read = {f.path for s in streams for f in s.files}
    found = []
    for folder in subfolders(base):
        files = [p for name in capture.rig.names for p in _pictures(folder / name)]
        if files and folder.name not in ("images", _PLACE) and not any(str(p.resolve()) in read for p in files):
            found.append(folder)
    return found


def _unread(base: Path, place: Path, layout: str, masked: bool) -> list[str]:
    """The sentence about files in a folder that is meant for masks."""
    found = [p for p in all_below(place) if p.is_file()]
    if not found:
        return []
    said = f"{place.name} holds {len(found)} files, such as {found[0].relative_to(base)}, and none is read as a mask"
    if not masked:
        return [f"{said} by the layout {layout}; the layouts images and videos read masks/CAM/000000.png"]
    return [f"{said}; {_to_be_read(base, found[0])}"]


def _to_be_read(base: Path, found: Path) -> str:
    """What makes a mask of a file that was not read as one."""
    if found.suffix.lower() in VIDEO_SUFFIXES:
        camera, film = base / _PLACE / found.stem, shlex.quote(str(found))
        frames = shlex.quote(str(camera / "%06d.png"))
        return (
            f"masks are pictures, so write the frames of each camera as such: mkdir -p {shlex.quote(str(camera))};"
            f" ffmpeg -i {film} -fps_mode passthrough -start_number 0 {frames}"
        )
    return "masks are read as masks/CAM/000000.png, by the camera's name and the picture's number, the subject white"


def _pictures(folder: Path) -> list[Path]:
    """Files of pictures in a folder; none where it does not exist."""
    return [p for p in entries(folder) if p.suffix.lower() in images.PICTURE_SUFFIXES]
