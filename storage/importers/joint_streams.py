"""2D and 3D joints of a capture as streams: which files, which joint set."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from posegaussian.storage.formats.joint_files import Detections, read_coco, read_trc
from posegaussian.storage.importers.common import file_stream, gap_notes, ranges
from posegaussian.storage.importers.numbering import as_numbered
from posegaussian.storage.model.capture import SourceFile, Stream
from posegaussian.storage.model.errors import SourceError
from posegaussian.storage.model.joint_sets import JOINT_SETS, joint_set
from posegaussian.storage.model.plausible import check_person

JOINTS = "2D joints"
_HINTS = {"body_25b": "25b", "h36m17": "h36m"}
"""What the name of a folder says where the joints are those of the rarer one of two sets that have as many."""


def guess_joint_set(joints: int, given: str | None, hint: str, where: Path) -> str:
    """Id of the joint set: the given one, else the known one with that many joints.

    Of two sets with as many joints, BODY_25 and COCO-17 are taken unless the hint, a folder's name, says 25b or h36m.
    Raises SourceError for an unknown id, one that does not fit, and a number of joints that no known set has.
    """
    if given is not None:
        if len(joint_set(given)) != joints:
            raise SourceError(f"{where} holds {joints} joints a person; joint_set {given} has {len(joint_set(given))}")
        return given
    fitting = [s.id for s in JOINT_SETS.values() if len(s) == joints]
    if not fitting:
        raise SourceError(
            f"{where} holds {joints} joints a person, which no known joint set has"
            f" ({', '.join(f'{s.id}: {len(s)}' for s in JOINT_SETS.values())})"
        )
    return next((id for id in fitting if id in _HINTS and _HINTS[id] in hint.lower()), fitting[0])


def _joints_a_person(files: Sequence[Path], read: Callable[[Path], Detections]) -> tuple[int, Path] | None:
    """(joints, file) of the first file that holds a person."""
    for p in files:
        if len((found := read(p)).joints):
            return found.joints.shape[1], p
    return None


def picture_joints(
    kind: str,
    read: Callable[[Path], Detections],
    names: Sequence[str],
    found: Mapping[str, Mapping[int, Path]],
    pictures: Sequence[Stream],
    given: str | None,
    hint: str,
) -> tuple[tuple[Stream | None, ...], list[str]]:
    """(joints of every view, notes) of formats with one file a picture; `found` is {camera: {number: file}}.

    No streams where no file holds a person. Files of frames without a picture are left out. Raises SourceError for
    joints that are numbered as their pictures are not, all off alike.
    """
    own, said = as_numbered(JOINTS, names, [found.get(n, {}) for n in names], pictures)
    kept = {
        n: {k: p for k, p in files.items() if k in set(s.numbers)}
        for n, files, s in zip(names, own, pictures, strict=True)
    }
    person = next((p for n in names if (p := _joints_a_person(list(kept[n].values()), read))), None)
    if person is None:
        return (), (
            ["the joint files hold no person" if any(kept.values()) else _of_no_picture(own, pictures)]
            if any(found.values())
            else []
        )
    chosen = guess_joint_set(person[0], given, hint, person[1])
    streams = tuple(file_stream(kind, kept[n], joint_set=chosen) if kept[n] else None for n in names)
    return streams, [f"2D joints: {kind} files, joint set {chosen}", *said, *_joint_gaps(names, streams, pictures)]


def coco_joints(
    names: Sequence[str], files: Mapping[str, Path], shared: bool, pictures: Sequence[Stream], given: str | None
) -> tuple[tuple[Stream | None, ...], list[str]]:
    """(joints of every view, notes) of COCO JSON:
    a file a view, or one `shared` by all that names each view's folder.

    Pictures are files: their numbers are those that joints must have. Raises SourceError where all are off alike.
    """
    contents = {n: read_coco(p, n if shared else None) for n, p in files.items()}
    person = next(
        ((d.joints.shape[1], files[n]) for n, c in contents.items() for d in c.values() if len(d.joints)), None
    )
    if person is None:
        return (), ["the joint files hold no person"] if files else []
    own, _ = as_numbered(JOINTS, names, [contents.get(n, {}) for n in names], pictures)
    if not any(frames.keys() & set(s.numbers) for frames, s in zip(own, pictures, strict=True)):
        return (), [_of_no_picture(own, pictures)]
    chosen = guess_joint_set(person[0], given, person[1].stem, person[1])
    streams: list[Stream | None] = []
    for name, frames, stream in zip(names, own, pictures, strict=True):
        numbers = sorted(frames.keys() & set(stream.numbers))
        options = {"joint_set": chosen, **({"view": name} if shared else {})}
        streams.append(
            Stream("coco", (SourceFile.of(files[name]),), tuple(numbers), options=options) if numbers else None
        )
    return tuple(streams), [f"2D joints: coco files, joint set {chosen}", *_joint_gaps(names, streams, pictures)]


def _of_no_picture(found: Sequence[Mapping[int, object]], pictures: Sequence[Stream]) -> str:
    """The sentence about joints whose numbers no picture has."""
    of, beside = (
        ranges(np.unique(np.concatenate([np.array(list(n), np.int64) for n in numbers])))
        for numbers in (found, [s.numbers for s in pictures])
    )
    return f"no joint belongs to a picture: joints are of frames {of}, pictures {beside}; number them alike"


def _joint_gaps(names: Sequence[str], streams: Sequence[Stream | None], pictures: Sequence[Stream]) -> list[str]:
    without = [f"camera {n} has no {JOINTS}" for n, s in zip(names, streams, strict=True) if s is None]
    return without + gap_notes(names, streams, [s.numbers for s in pictures], JOINTS)


def trc_joints(path: Path, axes: str) -> Stream:
    """3D joints of a TRC file; its joint set is the largest known one whose names its markers include.

    Raises SourceError when there is none, and for joints of another size than a person's.
    """
    trc = read_trc(path)
    fitting = [s for s in JOINT_SETS.values() if set(s.names) <= set(trc.markers)]
    if not fitting:
        raise SourceError(
            f"{path}: its {len(trc.markers)} markers ({', '.join(trc.markers[:6])}, ...) include no known joint set"
            f" ({', '.join(JOINT_SETS)})"
        )
    check_person(str(path), trc.points)
    best = max(fitting, key=len)
    return Stream(
        "trc", (SourceFile.of(path),), tuple(trc.numbers.tolist()), options={"joint_set": best.id, "axes": axes}
    )
