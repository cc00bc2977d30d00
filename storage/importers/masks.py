"""Masks of every view: which file belongs to which picture, and the sentences about what they hold.

White is the subject. A capture without files of masks has those that the alpha of its pictures holds.
"""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from posegaussian.storage.importers.common import all_below, file_stream, gap_notes, numbered, ranges, size_of
from posegaussian.storage.importers.numbering import as_numbered, told
from posegaussian.storage.importers.posed_pictures import Files
from posegaussian.storage.model.capture import Stream
from posegaussian.storage.model.errors import SourceError
from posegaussian.storage.model.masks import ROUND, rim_share
from posegaussian.storage.readers import images
from posegaussian.storage.readers.video import VIDEO_SUFFIXES

_LOOKED_AT = 5
"""Masks of a camera whose values are looked at."""
_FOLDERS = ("masks", "mask")
"""Folders in which masks are meant to lie."""

MaskFiles = Mapping[int, Path]
"""Masks of a camera by source frame number."""


def mask_streams(
    names: Sequence[str], folders: Sequence[Path], pictures: Sequence[Stream]
) -> tuple[tuple[Stream, ...], list[str]]:
    """(masks of every view, notes), one folder a camera; none at all where neither the folders nor the alpha of the
    pictures have any.

    Masks may be smaller or larger than their pictures, but show the same field. Raises SourceError when only some
    cameras have masks, for masks of another shape than their pictures, for masks that fit no picture by their numbers,
    and for masks that hold nothing.
    """
    files = [numbered(f, images.PICTURE_SUFFIXES) for f in folders]
    return mask_file_streams(names, files, pictures, folders)


def mask_file_streams(
    names: Sequence[str],
    files: Sequence[MaskFiles],
    pictures: Sequence[Stream],
    folders: Sequence[Path] | None = None,
    labels: bool = False,
) -> tuple[tuple[Stream, ...], list[str]]:
    """`mask_streams` of files {source frame number: mask} a camera; `folders` are where more would lie. With `labels`
    masks hold labels of parts, and whatever is not 0 is the subject."""
    if not any(files):
        return _alpha_masks(names, pictures)
    lacking = [n for n, f in zip(names, files, strict=True) if not f]
    if lacking:
        add = "theirs" if folders is None else folders[names.index(lacking[0])]
        raise SourceError(
            f"cameras {', '.join(lacking)} have no masks while others have; add {add} or move all masks away"
        )
    fitting, notes = _fitting(names, files, pictures)
    streams, sizes = _sized(names, fitting, pictures)
    notes += sizes
    notes += gap_notes(names, streams, [s.numbers for s in pictures], "masks")
    kind, more = _of_values(names, streams, labels)
    return tuple(replace(s, options=dict(kind)) for s in streams), [*notes, *more]


def masks_beside(root: Path, images_root: Path, camera: str, pictures: Files) -> dict[int, Path]:
    """{source frame number: mask} below `root` of a camera's pictures: by their names below `images_root`, with `.png`
    appended or in place of their ending, else `root/CAMERA/<number>.png`, as of videos."""
    out = {}
    for n, path in pictures.items() if isinstance(pictures, dict) else ():
        name = path.relative_to(images_root if path.is_relative_to(images_root) else root.parent)
        for candidate in (root / f"{name}.png", (root / name).with_suffix(".png")):
            if candidate.is_file():
                out[n] = candidate
                break
    return out or numbered(root / camera, images.PICTURE_SUFFIXES)


def unread_masks(base: Path, layout: str, masked: bool) -> list[str]:
    """The sentence about files that lie where masks are meant to, of a capture that has no masks; with `masked` the
    layout reads `masks/CAM/000000.png`."""
    for place in _FOLDERS:
        found = [p for p in all_below(base / place) if p.is_file()]
        if not found:
            continue
        said = f"{place} holds {len(found)} files, such as {found[0].relative_to(base)}, and none is read as a mask"
        if not masked:
            return [f"{said} by the layout {layout}; the layouts images and videos read masks/CAM/000000.png"]
        return [f"{said}; {_to_be_read(base, found[0])}"]
    return []


def _to_be_read(base: Path, found: Path) -> str:
    """What makes a mask of a file that was not read as one."""
    if found.suffix.lower() in VIDEO_SUFFIXES:
        camera, film = base / "masks" / found.stem, shlex.quote(str(found))
        frames = shlex.quote(str(camera / "%06d.png"))
        return (
            f"masks are pictures, so write the frames of each camera as such: mkdir -p {shlex.quote(str(camera))};"
            f" ffmpeg -i {film} -fps_mode passthrough -start_number 0 {frames}"
        )
    return "masks are read as masks/CAM/000000.png, by the camera's name and the picture's number, the subject white"


def _fitting(
    names: Sequence[str], files: Sequence[MaskFiles], pictures: Sequence[Stream]
) -> tuple[list[MaskFiles], list[str]]:
    """(the masks of every view that belong to pictures, notes). Raises SourceError for masks that fit no picture."""
    files, notes = as_numbered("masks", names, files, pictures)
    fitting: list[MaskFiles] = []
    for name, found, stream in zip(names, files, pictures, strict=True):
        known = set(stream.numbers)
        own = {n: p for n, p in found.items() if n in known}
        if not own:
            raise SourceError(
                f"camera {name}: {told('masks', found, stream.numbers)}: none fits; number masks as their pictures are"
            )
        if stray := sorted(found.keys() - own.keys()):
            notes.append(
                f"camera {name}: masks of {len(stray)} frames ({ranges(np.array(stray))}) belong to no picture and are"
                " left out; number masks as their pictures are"
                + (", those of a video from 0" * (stream.kind == "video"))
            )
        fitting.append(own)
    return fitting, notes


def _sized(
    names: Sequence[str], files: Sequence[MaskFiles], pictures: Sequence[Stream]
) -> tuple[list[Stream], list[str]]:
    """(streams of masks, notes on those that are smaller or larger than their pictures). Raises SourceError."""
    streams, alike = [], dict[str, list[str]]()
    for name, own, stream in zip(names, files, pictures, strict=True):
        (width, height), shown = size_of("mask", name, own, stream.size), stream.size
        streams.append(file_stream("images", own, (width, height)))
        if (width, height) != tuple(shown):
            how = "enlarged" if width * height < shown[0] * shown[1] else "reduced"
            said = (
                f"masks are {width}x{height} px, pictures {shown[0]}x{shown[1]} px: the same shape, so masks are {how}"
                " to the pictures' size when read"
            )
            alike.setdefault(said, []).append(name)
    notes = [f"camera{'s' if len(of) > 1 else ''} {', '.join(of)}: {said}" for said, of in alike.items()]
    return streams, notes


def _of_values(names: Sequence[str], streams: Sequence[Stream], labels: bool) -> tuple[dict[str, bool], list[str]]:
    """(how the values of masks are read, notes), by a few masks of every view. Raises SourceError for masks of which
    none holds anything."""
    largest, rims = {}, []
    for name, stream in zip(names, streams, strict=True):
        masks = [images.read_mask(f.path) for f in stream.files[:: max(1, len(stream.files) // _LOOKED_AT)]]
        largest[name] = max(int(m.max()) for m in masks)
        rims.append(float(np.mean([rim_share(m > largest[name] // 2) for m in masks])))
    empty = [n for n, most in largest.items() if not most]
    if len(empty) == len(streams) and not any(images.read_mask(f.path).any() for s in streams for f in s.files):
        raise SourceError(
            f"masks hold nothing: all are 0 throughout, such as {streams[0].files[0].path}; write the subject white"
            " into them, or move them away to have it cut out without"
        )
    notes = []
    if empty:
        notes.append(
            f"masks of {', '.join(empty)} hold nothing in the frames looked at: is the subject not seen there?"
        )
    kind = {"labels": True} if labels else {"zero_one": True} if max(largest.values()) == 1 else {}
    if labels:
        notes.append("masks hold labels of body parts; whatever is not 0 is the subject")
    elif kind:
        notes.append("masks hold only 0 and 1; they are read as 0 and 255")
    return kind, notes + _of_rims(dict(zip(names, rims, strict=True)))


def _of_rims(rims: Mapping[str, float]) -> list[str]:
    """The sentence about masks that are white along most of the rim, in all cameras or in some: {camera: share}."""
    again = "The subject must be white; if it is black, write them the other way round and import again"
    if (middle := float(np.median(list(rims.values())))) > ROUND:
        told = f"masks are white along {middle:.0%} of the pictures' rim"
        return [f"{told}: they seem to mark the background, or to cut nothing out. {again}"]
    if round_ := [n for n, share in rims.items() if share > ROUND]:
        least = min(rims[n] for n in round_)
        told = f"masks of {', '.join(round_)} are white along {least:.0%} of the pictures' rim, unlike the others'"
        return [f"{told}: they seem to mark the background, or to cut nothing out. {again}"]
    return []


def _alpha_masks(names: Sequence[str], pictures: Sequence[Stream]) -> tuple[tuple[Stream, ...], list[str]]:
    """(the alpha of RGBA pictures as masks, notes); none where a camera's first picture has none or is opaque."""
    cut = [n for n, s in zip(names, pictures, strict=True) if s.kind == "images" and _is_cut_out(s.files[0].path)]
    if not cut:
        return (), []
    if opaque := [n for n in names if n not in cut]:
        said = (
            f"the alpha of the pictures of {', '.join(cut)} is not used as masks, as those of {', '.join(opaque)} are"
            " opaque; give all cameras' pictures one, or none"
        )
        return (), [said]
    return tuple(replace(s, options={"alpha": True}) for s in pictures), ["masks: the alpha of the pictures"]


def _is_cut_out(picture: str) -> bool:
    """Whether a picture has an alpha that is not opaque throughout."""
    return images.has_alpha(picture) and bool(images.read_mask(picture, alpha=True).min() < np.iinfo(np.uint8).max)
