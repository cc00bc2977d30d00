"""2D joints that Caliscope's trackers left beside a recording: `TRACKER/xy_TRACKER.csv`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from posegaussian.storage.formats.joint_files import TrackedFrame, read_tracked
from posegaussian.storage.importers.caliscope_times import Instants
from posegaussian.storage.importers.common import gap_notes, subfolders
from posegaussian.storage.model.capture import SourceFile, Stream
from posegaussian.storage.model.errors import SourceError
from posegaussian.storage.model.joint_sets import joint_set

_SAME_TIME = 1e-4
"""Seconds by which a frame's time may differ in the two tables; text of few digits rounds."""


def known_set(tracker: str) -> str | None:
    """Joint set whose indices a tracker uses as landmark numbers, None where that is not known.

    POSE and HOLISTIC number MediaPipe's 33 pose landmarks from 0 and put hands and face at 100 and more; the models
    that Caliscope ships are named after Halpe-26 (https://github.com/mprib/caliscope, docs/onnx_trackers.md).
    """
    if tracker in ("POSE", "HOLISTIC"):
        return "blazepose33"
    return "halpe26" if tracker.startswith("ONNX_") and "halpe26" in tracker.lower() else None


def tracked_joints(
    base: Path,
    cameras: Mapping[str, int],
    matched: Instants,
    pictures: Sequence[Stream],
    tracker: str | None,
    given: str | None,
) -> tuple[tuple[Stream | None, ...], list[str]]:
    """(joints of every view, notes) of the chosen tracker or the only one whose joint set is known; `cameras` is {name:
    id}.

    Raises SourceError for a tracker that left nothing or whose joint set is not known or given, for several that fit,
    and for a table of another recording.
    """
    found = {p.stem.removeprefix("xy_"): p for f in subfolders(base) for p in sorted(f.glob("xy_*.csv"))}
    if tracker is not None and tracker not in found:
        raise SourceError(
            f"option tracker: no {tracker}/xy_{tracker}.csv in {base}; there are {', '.join(found) or 'none'}"
        )
    fitting = {
        t: id
        for t in ([tracker] if tracker is not None else found)
        if (id := given if given and tracker else known_set(t))
    }
    if tracker is not None and not fitting:
        raise SourceError(
            f"option tracker: which joints {tracker} numbers is not known; name a joint set in their order with the"
            " option joint_set"
        )
    if len(fitting) > 1:
        raise SourceError(
            f"landmarks of several trackers fit: {', '.join(fitting)}; choose one with the option tracker"
        )
    unknown = [t for t in found if tracker is None and t not in fitting]
    notes = [
        f"landmarks of {t} are left out: which joints it numbers is not known;"
        " choose it with the options tracker and joint_set"
        for t in unknown
    ]
    if not fitting:
        return (), [*notes, "no 2D joints"]
    (name, id), *_ = fitting.items()
    path, chosen = found[name], joint_set(id).id
    tables = read_tracked(path)
    streams = tuple(
        _stream(path, c, chosen, _by_instant(path, c, tables.get(c, {}), matched)) for c in cameras.values()
    )
    names = tuple(cameras)
    without = [f"camera {n} has no 2D joints" for n, s in zip(names, streams, strict=True) if s is None]
    return streams, [
        f"2D joints: landmarks of {name}, joint set {chosen}",
        *notes,
        *without,
        *gap_notes(names, streams, [s.numbers for s in pictures], "2D joints"),
    ]


def _stream(path: Path, camera: int, joints: str, syncs: Mapping[int, int]) -> Stream | None:
    if not syncs:
        return None
    return Stream(
        "caliscope",
        (SourceFile.of(path),),
        tuple(syncs),
        options={"joint_set": joints, "camera": camera, "indices": list(syncs.values())},
    )


def _by_instant(path: Path, camera: int, tracked: Mapping[int, TrackedFrame], matched: Instants) -> dict[int, int]:
    """{instant: the table's own sync_index} of one camera.

    Trackers number instants anew, and older ones frames, too: a frame is known by its time where there are times, else
    by its index.
    """
    instant = {frame: n for n, frame in matched.frames[camera].items()}
    times = np.array(matched.times.get(camera, ()))
    out = {}
    for sync, found in tracked.items():
        frame = int(np.abs(times - found.frame_time).argmin()) if len(times) else found.frame_index
        if abs(times[frame] - found.frame_time) > _SAME_TIME if len(times) else frame not in instant:
            what = f"frame_time {found.frame_time:g}" if len(times) else f"frame_index {found.frame_index}"
            raise SourceError(
                f"{path}: camera {camera} has landmarks at {what}, where its video has no frame; track this recording"
                " again, or move the file away"
            )
        if frame in instant:
            out[instant[frame]] = sync
    return dict(sorted(out.items()))
