"""Masks of every view: which file belongs to which picture, and the sentences about what they hold.

White is the subject. A capture without files of masks has those that the alpha of its pictures holds.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from posegaussian.storage.importers.common import file_stream, gap_notes, ranges, size_of
from posegaussian.storage.importers.mask_cut_outs import as_cut_out
from posegaussian.storage.importers.mask_files import check_one_a_frame, masks_in
from posegaussian.storage.importers.mask_range import RIGHT, Range, range_notes, ranges_of, value_range
from posegaussian.storage.importers.numbering import as_numbered, told
from posegaussian.storage.model.capture import Stream
from posegaussian.storage.model.errors import SourceError
from posegaussian.storage.model.masks import FOREGROUND, MOST, ROUND, foreground, line_widths, rim_share
from posegaussian.storage.readers import images
from posegaussian.storage.readers.mask_options import read_as_meant

_LOOKED_AT = 5
"""Masks of a camera whose values are looked at."""

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
    files = [masks_in(f) for f in folders]
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
            f"cameras {', '.join(lacking)} have no masks while others have; add {add}, where black masks say that the"
            " subject is not seen and nothing is taken of a camera's pictures; or leave these cameras out of the"
            " capture; or move all masks away, and a run cuts the person out of all pictures (frames.matte: person)"
        )
    fitting, notes = _fitting(names, files, pictures)
    streams, sizes = _sized(names, fitting, pictures)
    notes += sizes
    notes += mask_gaps(names, streams, pictures)
    streams, cut = (streams, []) if labels else as_cut_out(names, streams)
    streams, lines = _without_lines(names, streams)
    kinds, more = _of_values(names, streams, labels)
    read = [replace(s, options={**s.options, **k}) for s, k in zip(streams, kinds, strict=True)]
    return tuple(read), [*notes, *cut, *lines, *more]


def mask_gaps(names: Sequence[str], streams: Sequence[Stream | None], pictures: Sequence[Stream]) -> list[str]:
    """A sentence for every camera that has pictures without a mask, and what becomes of these."""
    if notes := gap_notes(names, streams, [s.numbers for s in pictures], "masks"):
        notes.append(
            "pictures that lack a mask are left out of a run, and their frames are made of the other cameras; add the"
            " masks, black ones where nothing of the subject is seen, and import again"
        )
    return notes


def _fitting(
    names: Sequence[str], files: Sequence[MaskFiles], pictures: Sequence[Stream]
) -> tuple[list[MaskFiles], list[str]]:
    """(the masks of every view that belong to pictures, notes). Raises SourceError for masks that fit no picture."""
    files, notes = as_numbered("masks", names, files, pictures)
    fitting: list[MaskFiles] = []
    for name, found, stream in zip(names, files, pictures, strict=True):
        check_one_a_frame(found.values(), stream)
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


def _without_lines(names: Sequence[str], streams: Sequence[Stream]) -> tuple[list[Stream], list[str]]:
    """(streams whose masks are read without a line that was drawn along the pictures' edges, notes), by a few of every
    view's masks: most have it."""
    widths = {}
    for name, stream in zip(names, streams, strict=True):
        masks = list(_read(stream, _LOOKED_AT))
        white = max(int(m.max()) for m in masks)
        found = np.sort([line_widths(m > white // 2) for m in masks], axis=0)
        widths[name] = found[(len(found) - 1) // 2].tolist()
    lined = [n for n, found in widths.items() if any(found)]
    if not lined:
        return list(streams), []
    whose = "" if len(lined) == len(names) else f" of {', '.join(lined)}"
    note = (
        f"masks{whose} are white in a line of up to {max(map(max, widths.values()))} px along the pictures' edges and"
        " black beside it: it was drawn, is no subject, and is read as what lies beside it"
    )
    options: list[dict[str, Any]] = [{"line": found} if any(found) else {} for found in widths.values()]
    return [replace(s, options={**s.options, **o}) for s, o in zip(streams, options, strict=True)], [note]


def _read(stream: Stream, most: int | None = None) -> Iterator[np.ndarray]:
    """A view's masks [h, w] uint8 as its options say they are read, or about so many of them."""
    for file in stream.files[:: max(1, len(stream.files) // most) if most else 1]:
        yield read_as_meant(file.path, stream.options)


def _of_values(names: Sequence[str], streams: Sequence[Stream], labels: bool) -> tuple[list[dict[str, Any]], list[str]]:
    """(how the values of every view's masks are read, notes), by a few masks of each. Raises SourceError for masks of
    which none holds anything, and where no camera's hold any white."""
    values, rims, black, seen = {}, {}, [], dict[str, Range | None]()
    for name, stream in zip(names, streams, strict=True):
        masks = list(_read(stream, _LOOKED_AT))
        values[name] = {int(v) for m in masks for v in np.flatnonzero(np.bincount(m.ravel()))} - {0}
        rims[name] = float(np.mean([rim_share(m > max(values[name], default=0) // 2) for m in masks]))
        # one that is not as the others are is read the other way round (`posegaussian.storage.readers.sources`)
        black.append(float(np.median([(m > max(values[name], default=0) // 2).mean() for m in masks])) < MOST)
        seen[name] = value_range(masks)
    empty = [n for n, held in values.items() if not held]
    if len(empty) == len(streams) and not any(m.any() for s in streams for m in _read(s)):
        raise SourceError(
            f"masks hold nothing: all are 0 throughout, such as {streams[0].files[0].path}; write the subject white"
            " into them, or move them away to have it cut out without"
        )
    notes = []
    if empty:
        notes.append(
            f"masks of {', '.join(empty)} hold nothing in the frames looked at: is the subject not seen there?"
        )
    kinds: list[dict[str, Any]]
    if labels:
        kinds = [{"labels": True}] * len(names)
        told = ["masks hold labels of body parts; whatever is not 0 is the subject"]
    else:
        kinds, told = _spread(values, streams)
        ranges = ranges_of({n: RIGHT if kind else seen[n] for n, kind in zip(names, kinds, strict=True)})
        kinds = [k or ({} if r == RIGHT else {"range": list(r)}) for k, r in zip(kinds, ranges.values(), strict=True)]
        told = [*told, *range_notes(ranges)]
    kinds = [k | ({"mostly_black": True} if b else {}) for k, b in zip(kinds, black, strict=True)]
    return kinds, [*notes, *told, *_of_rims(rims)]


def _spread(values: Mapping[str, set[int]], streams: Sequence[Stream]) -> tuple[list[dict[str, Any]], list[str]]:
    """(what makes white of the subject, notes) for every view, by the values other than 0 in those of its masks that
    were looked at: {camera: values}. One value below white is the subject, as 1 and other labels are; several are a
    soft rim or noise, which count as nothing. Raises SourceError where no mask holds anything else."""
    of = dict(zip(values, streams, strict=True))
    dark = {n: held for n, held in values.items() if held and max(held) <= FOREGROUND}
    label = {n: min(held) for n, held in dark.items() if len(held) == 1}
    alike = len(set(label.values())) == 1 and len(label) == sum(bool(held) for held in values.values())
    if not alike:  # unlike other cameras', so it may as well be what noise left where nobody is seen
        label = {n: v for n, v in label.items() if _is_patch(of[n], v)}
    faint = [n for n in dark if n not in label]
    shown = any(held and n not in faint for n, held in values.items())
    if faint and not shown and not any(_has_white(s) for s in streams):
        raise SourceError(
            f"masks of {', '.join(faint)} hold values up to {max(max(dark[n]) for n in faint)}, such as"
            f" {of[faint[0]].files[0].path}, and none above {FOREGROUND}, from where on it is the subject; write the"
            " subject as 255 (of labels: mogrify -threshold 0 FILES makes white of whatever is not 0)"
        )
    notes = []
    for value in sorted(set(label.values())):
        whose = "" if alike else f" of {', '.join(n for n in label if label[n] == value)}"
        how = "they are read as 0 and 255" if value == 1 else "whatever is not 0 is read as the subject"
        notes.append(f"masks{whose} hold only 0 and {value}; {how}")
    if faint and shown:
        notes.append(
            f"masks of {', '.join(faint)} hold nothing above {FOREGROUND} in the frames looked at, so nobody is seen"
            " there; the subject is 255"
        )
    kinds: dict[str, dict[str, Any]] = {n: {"zero_one": True} if v == 1 else {"labels": True} for n, v in label.items()}
    # A camera that sees nobody in the frames looked at is read as all the others are.
    common = next(iter(kinds.values())) if alike else {}
    return [kinds.get(n, {} if held else common) for n, held in values.items()], notes


def _is_patch(stream: Stream, value: int) -> bool:
    """Whether all masks of a view hold 0 and one value alone, and that in patches, as a subject, not in specks."""
    inner = whole = 0
    for mask in _read(stream):
        held = mask > 0
        if (mask[held] != value).any():
            return False
        beside = held[:-2, 1:-1] & held[2:, 1:-1] & held[1:-1, :-2] & held[1:-1, 2:]
        inner, whole = inner + int((held[1:-1, 1:-1] & beside).sum()), whole + int(held.sum())
    return 2 * inner >= whole


def _has_white(stream: Stream) -> bool:
    """Whether any mask of a view holds the subject."""
    return any(foreground(m).any() for m in _read(stream))


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
