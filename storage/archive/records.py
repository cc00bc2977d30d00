"""The record of a sequence: what its `zarr.json` says of the capture, checked before anybody follows it."""

from __future__ import annotations

import json
import math
import os
from pathlib import Path
from typing import Any

import numpy as np

from posegaussian.storage.archive import checksums
from posegaussian.storage.files.names import check_camera_names, parse_json, read_file
from posegaussian.storage.files.write import write_atomically
from posegaussian.storage.model.cameras import INTRINSICS_AXES, POSE_AXES, Rig
from posegaussian.storage.model.capture import ONE_FILE, PER_VIEW, Capture, SourceFile, Stream
from posegaussian.storage.model.errors import ArchiveError, BrokenRecord, CalibrationError, SourceError
from posegaussian.storage.model.timegrid import parse_range

FORMAT = 1
"""Number of the archive format this version writes; newer ones are refused."""

ATTRIBUTES = "posegaussian"
"""Key of the project's record in the attributes of a sequence's group."""

FILE = "zarr.json"
"""Name of the file of every Zarr group and array."""

NESTED = ("_variants", "_reshard")
"""Folders of an archive that hold sequences with its captures, two levels below."""

MOST_BYTES = 2**30
"""Bytes of a record: every picture file of a capture is named in it."""

MOST_PARTITION = 65536
"""Frames of a partition: a shard's index has an entry for each."""

MOST_SIDE = 65536
"""Px of a picture's side: arrays are made for such pictures before one is read."""

MOST_NUMBER = 2**31
"""Size of a frame's number, of either sign."""

KINDS = ("video", "images", "openpose", "coco", "easymocap", "caliscope", "trc", "hdf5", "bodies")
"""Kinds of streams."""


def read_record(root: Path) -> dict[str, Any]:
    """The record of the sequence in a folder.

    Raises BrokenRecord when it is missing, cannot be read or is not what its checksum was taken of, ArchiveError for a
    newer format.
    """
    file = root / FILE
    try:
        record = parse_json(read_file(file, MOST_BYTES))["attributes"][ATTRIBUTES]
        number = int(record["format"])
    except (OSError, ValueError, KeyError, TypeError, OverflowError) as e:
        raise BrokenRecord(
            f"{root} is not a sequence of a PoseGaussian archive ({type(e).__name__}: {e}); import the capture again"
        ) from e
    if number > FORMAT:
        raise ArchiveError(
            f"sequence {root.name} is of archive format {number}, this version reads up to {FORMAT};"
            " update posegaussian"
        )
    if checksums.changed(record):
        raise BrokenRecord(
            f"{file} changed since it was written: its cameras, files or times are not those its checksum was taken of,"
            " and nothing is computed from them; put the old file back, or import the capture again"
        )
    frames = record.get("partition_frames")
    if type(frames) is not int or not 1 <= frames <= MOST_PARTITION:
        raise BrokenRecord(
            f"{file} says that partitions have {str(frames)[:40]} frames, they have 1 to {MOST_PARTITION};"
            " import the capture again"
        )
    return record


def write_record(root: Path, record: dict[str, Any]) -> None:
    """Write the record with its checksum; other attributes of the group stay.
    Readers see the old one or the new one."""
    try:
        attributes = parse_json(read_file(root / FILE, MOST_BYTES))["attributes"]
    except (OSError, ValueError, KeyError, TypeError):
        attributes = {}
    write_atomically(root / FILE, record_text(record, attributes if isinstance(attributes, dict) else {}))


def record_text(record: dict[str, Any], beside: dict[str, Any]) -> bytes:
    """The file of a record with its checksum, and of other attributes of the group."""
    attributes = {**beside, ATTRIBUTES: checksums.sealed(record)}
    return json.dumps({"attributes": attributes, "zarr_format": 3, "node_type": "group"}, indent=2).encode()


def read_capture(record: dict[str, Any], file: Path) -> Capture:
    """The capture that a record describes. Raises BrokenRecord where it cannot be one, naming the record's file."""
    try:
        capture = Capture.from_json(record["capture"], _home(file.parent))
        why = _fault(capture)
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError, IndexError) as e:
        why = f"{type(e).__name__}: {e}"
    except (CalibrationError, SourceError) as e:
        why = str(e)
    if why is not None:
        raise BrokenRecord(
            f"{file} does not describe a capture ({why}); put the file back as it was, or import the capture again"
        )
    return capture


def as_recorded(capture: Capture, root: Path) -> dict[str, Any]:
    """A capture as the record of the sequence in a folder has it: files that lie in the archive by their path from the
    archive, so that it can be moved or copied to another machine."""
    return capture.to_json(_home(root))


def _home(root: Path) -> str:
    """The archive of a sequence's folder, links followed; of one within one of the archive's own folders, such as a
    variant, that archive."""
    within = root.resolve().parent
    return str(within.parent.parent if within.parent.name in NESTED else within)


def check_capture(capture: Capture) -> None:
    """Raise SourceError or CalibrationError for a capture whose record would be refused by `read_capture`."""
    why = _fault(Capture.from_json(capture.to_json()))
    if why is not None:
        raise SourceError(
            f"the capture of layout {capture.layout} cannot be registered: {why}; nothing was written. Take what is"
            " named out of its folder, and import it again"
        )


def _fault(capture: Capture) -> str | None:
    """What is wrong with a capture that was read, or None. Raises CalibrationError."""
    rig, count = capture.rig, len(capture.rig)
    check_camera_names(rig.names)
    shapes = {
        "intrinsics": (count, 3, 3),
        "distortion": (count, 8),
        "world_to_camera": (count, 4, 4),
        "size": (count, 2),
    }
    for name, shape in shapes.items():
        if getattr(rig, name).shape != shape or not count:
            return f"{name} of {count} cameras are {getattr(rig, name).shape}"
    rig.check()
    if rig.size.max() > MOST_SIDE:
        return f"pictures of {rig.size.max()} px a side, at most {MOST_SIDE} are read"
    if not (
        isinstance(capture.frame_rate, int | float) and math.isfinite(capture.frame_rate) and capture.frame_rate > 0
    ):
        return f"frame rate {capture.frame_rate}"
    if not all(isinstance(text, str) for text in (capture.layout, capture.data_set, *capture.notes)):
        return "layout, data set and notes are not text"
    for kind in PER_VIEW:
        streams = capture.streams(kind)
        if len(streams) not in ((count,) if kind == "pictures" else (0, count)) or (
            kind == "pictures" and None in streams
        ):
            return f"{len(streams)} streams of {kind} for {count} cameras"
    split_texts = [t for s in capture.splits.values() for t in (*s.sources, *s.held_out, s.frames or "")]
    if not all(isinstance(t, str) for t in (*capture.splits, *split_texts)):
        return "protocols name cameras and frames by other than text"
    for split in capture.splits.values():
        parse_range(split.frames or "::")
    for what, named in (("crops", capture.crops), ("held_out", capture.held_out)):
        if strange := [n for n in named if n not in rig.names]:
            return f"{what} name {str(strange[0])[:40]!r}, which is no camera"
    every = [s for k in (*PER_VIEW, "joints3d") for s in capture.streams(k) if s is not None]
    return next((why for s in every if (why := _stream_fault(s)) is not None), None)


def _stream_fault(stream: Stream) -> str | None:
    if stream.kind not in KINDS:
        return f"a stream of kind {str(stream.kind)[:40]!r}"
    if not stream.numbers or not all(type(n) is int and abs(n) < MOST_NUMBER for n in stream.numbers):
        return f"frame numbers of a stream are not whole numbers up to {MOST_NUMBER}"
    if len(stream.files) != (1 if stream.kind in ONE_FILE else len(stream.numbers)):
        return f"{len(stream.files)} files of {len(stream.numbers)} frames, kind {stream.kind}"
    if len(stream.size) != 2 or not all(type(n) is int and 0 <= n <= MOST_SIDE for n in stream.size):
        return f"pictures of {str(stream.size)[:40]} px"
    options = stream.options
    if not isinstance(options, dict) or len(options.get("indices", stream.numbers)) != len(stream.numbers):
        return "options of a stream do not fit its frames"
    if not all(type(n) is int and 0 <= n < MOST_NUMBER for n in options.get("indices", ())):
        return "indices of a stream are not whole numbers"
    if stream.kind == "bodies" and type(options.get("person")) is not int:
        return "joints in space without a person"
    if not isinstance(options.get("joint_set", ""), str):
        return "a joint set without a name"
    if stream.kind == "hdf5" and not isinstance(options.get("data"), str):
        return "a stream of an HDF5 file without a path in it"
    if not all(type(n) is int and 0 <= n < MOST_NUMBER for n in options.get("picked", ())):
        return "joints picked by other than whole numbers"
    return next((why for f in stream.files if (why := _file_fault(f)) is not None), None)


def _file_fault(file: SourceFile) -> str | None:
    """A source lies where it was imported from, anywhere;
    an empty one, as devices and pipes look, was never imported."""
    if not isinstance(file.path, str) or not os.path.isabs(file.path) or "\0" in file.path or len(file.path) > 4096:
        return f"source file {str(file.path)[:80]!r} is no absolute path"
    if (
        not isinstance(file.sha256, str)
        or type(file.size) is not int
        or type(file.mtime_ns) is not int
        or file.size < 1
    ):
        return f"source file {file.path[:80]} without size, time or digest"
    return None


def cameras(rig: Rig) -> dict[str, tuple[np.ndarray, tuple[str, ...], str, str]]:
    """{array: (values, dimensions, unit, meaning)} of the calibrated cameras beside the record,
    for other readers of Zarr."""
    return {
        "source/intrinsics": (
            rig.intrinsics,
            ("view", *INTRINSICS_AXES),
            "px",
            "Calibrated cameras, our pixel centres.",
        ),
        "source/distortion": (rig.distortion, ("view", "coefficient"), "1", "OpenCV k1 k2 p1 p2 k3 k4 k5 k6."),
        "source/world_to_camera": (rig.world_to_camera, ("view", *POSE_AXES), "m", "Rigid motion, OpenCV axes."),
        "source/size": (rig.size.astype(np.int32), ("view", "wh"), "px", "Size of the calibrated picture."),
    }
