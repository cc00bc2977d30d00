"""2D and 3D joints of a capture as streams: which files, which joint set."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from posegaussian.storage.formats.joint_files import Detections, read_coco, read_trc
from posegaussian.storage.importers.common import file_stream, gap_notes
from posegaussian.storage.model.capture import SourceFile, Stream
from posegaussian.storage.model.errors import SourceError
from posegaussian.storage.model.joint_sets import JOINT_SETS, joint_set
from posegaussian.storage.model.plausible import check_person

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

    No streams where no file holds a person. Files of frames without a picture are left out.
    """
    kept = {
        n: {k: p for k, p in found.get(n, {}).items() if k in set(s.numbers)}
        for n, s in zip(names, pictures, strict=True)
    }
    person = next((p for n in names if (p := _joints_a_person(list(kept[n].values()), read))), None)
    if person is None:
        return (), (
            ["the joint files hold no person" if any(kept.values()) else "no joint file belongs to a picture"]
            if any(found.values())
            else []
        )
    chosen = guess_joint_set(person[0], given, hint, person[1])
    streams = tuple(file_stream(kind, kept[n], joint_set=chosen) if kept[n] else None for n in names)
    return streams, [f"2D joints: {kind} files, joint set {chosen}", *_joint_gaps(names, streams, pictures)]


def coco_joints(
    names: Sequence[str], files: Mapping[str, Path], shared: bool, pictures: Sequence[Stream], given: str | None
) -> tuple[tuple[Stream | None, ...], list[str]]:
    """(joints of every view, notes) of COCO JSON:
    a file a view, or one `shared` by all that names each view's folder."""
    contents = {n: read_coco(p, n if shared else None) for n, p in files.items()}
    person = next(
        ((d.joints.shape[1], files[n]) for n, c in contents.items() for d in c.values() if len(d.joints)), None
    )
    if person is None:
        return (), ["the joint files hold no person"] if files else []
    chosen = guess_joint_set(person[0], given, person[1].stem, person[1])
    streams: list[Stream | None] = []
    for name, stream in zip(names, pictures, strict=True):
        numbers = sorted(set(contents.get(name, {})) & set(stream.numbers))
        options = {"joint_set": chosen, **({"view": name} if shared else {})}
        streams.append(
            Stream("coco", (SourceFile.of(files[name]),), tuple(numbers), options=options) if numbers else None
        )
    return tuple(streams), [f"2D joints: coco files, joint set {chosen}", *_joint_gaps(names, streams, pictures)]


def _joint_gaps(names: Sequence[str], streams: Sequence[Stream | None], pictures: Sequence[Stream]) -> list[str]:
    without = [f"camera {n} has no 2D joints" for n, s in zip(names, streams, strict=True) if s is None]
    return without + gap_notes(names, streams, [s.numbers for s in pictures], "2D joints")


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
