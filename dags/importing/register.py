"""Registering a capture: importer -> capture -> a sequence of the archive, with its partition length fixed."""

from __future__ import annotations

import dataclasses
import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np

from posegaussian.dags.config.yaml_source import parse_value
from posegaussian.dags.importing.replace import make_room, same
from posegaussian.stages.imaging.camera_mapping import frames_rig, one_to_one, undistorted
from posegaussian.stages.registry import STAGES
from posegaussian.storage.archive.records import as_recorded, check_capture
from posegaussian.storage.archive.store import SOURCES, Archive, SequenceGroup
from posegaussian.storage.files.names import refuse_links
from posegaussian.storage.files.write import whole_file
from posegaussian.storage.importers import find
from posegaussian.storage.model.cameras import Rig
from posegaussian.storage.model.capture import PER_VIEW, Capture, SourceFile, Stream
from posegaussian.storage.model.crop import captured_to_calibrated
from posegaussian.storage.model.errors import ConfigError, NotWritten, SourceError
from posegaussian.storage.model.joint_sets import JOINT_SETS
from posegaussian.storage.model.spec import ArraySpec


def find_capture(layout: str, source: Path, assignments: list[str], settings: Any) -> Capture:
    """Let an importer look through a folder.

    `assignments` are the layout's options as key=value; crops come from `frames.crop` of the settings.

    Raises:
        ConfigError: an assignment that is not key=value.
        SourceError, CalibrationError: an unknown layout or option, and what the importer found wrong.
    """
    options: dict[str, Any] = {"crop": {n: c.model_dump() for n, c in settings.frames.crop.items()}}
    for text in assignments:
        key, separator, value = text.partition("=")
        if not separator:
            raise ConfigError(f"--option {text}: write it as key=value, for example frame_rate=30")
        options[key.strip()] = parse_value(value)
    return find.find_capture(layout, source, options)


def partition_length(capture: Capture, settings: Any) -> int:
    """Frames of a partition: as given, else what the byte budget of the largest shard allows, within bounds."""
    wanted = settings.partition
    if wanted.frames is not None:
        return int(wanted.frames)
    crops = captured_to_calibrated(capture.rig.names, {**capture.crops, **settings.frames.crop})
    rig, captured = frames_rig(capture.rig, settings.frames.size), np.array([s.size for s in capture.pictures])
    rig = undistorted(rig, capture.rig, captured, crops)
    sets = [s.options["joint_set"] for s in (*capture.joints, capture.joints3d) if s is not None]
    shape = {
        "y": int(rig.size[:, 1].max()),
        "x": int(rig.size[:, 0].max()),
        "joint": max((len(JOINT_SETS[s]) for s in sets), default=1),
        "found_joint": max(map(len, JOINT_SETS.values())),
        "frame": 1,
        "view": 1,
        "person": settings.detection.people,
    }
    specs = [w for s in STAGES for w in s.writes if isinstance(w, ArraySpec) and w.per_frame and "path" not in s.over]
    largest = max(int(np.prod(w.lengths(shape))) * np.dtype(w.dtype).itemsize for w in specs)
    return int(min(max(1, wanted.megabytes * 1e6 // largest), wanted.most_frames))


def register(
    archive: Archive, name: str, capture: Capture, settings: Any, copy: bool = False, replace: bool = False
) -> tuple[SequenceGroup, list[str]]:
    """Write a capture into the archive; returns the sequence and sentences about what was decided.

    A sequence that exists keeps its partition length, so that what was computed stays usable. Raises ArchiveError where
    it holds another capture, unless that is to be replaced.
    """
    archive.check_sequence_name(name)
    check_capture(capture)
    length = partition_length(capture, settings)
    old, said = make_room(archive, name, same(capture), "this", replace)
    said += _folding(capture.rig)
    if copy:
        capture = _copied_whole(capture, archive.place(name))
    if old is not None:
        said.append(_updated(old, capture, length))
        length = old.partition_frames
    return archive.create_sequence(name, capture, length), said


def _folding(rig: Rig) -> list[str]:
    """A sentence on the cameras whose lens model folds back within the picture."""
    held = {name: one_to_one(rig, v) for v, name in enumerate(rig.names)}
    if not (folding := [name for name, share in held.items() if share < 1]):
        return []
    told = (
        f"camera{'s' if len(folding) > 1 else ''} {', '.join(folding)}: the lens model folds back at"
        f" {min(held.values()):.0%} of the way to the corner; what lies beyond cannot be undone and stays black, so"
        " calibrate again with fewer coefficients (k1 k2 alone) and a board that reaches the corners"
    )
    return [told]


def _updated(old: SequenceGroup, capture: Capture, length: int) -> str:
    """What importing the capture of a sequence again does to it."""
    if json.dumps(as_recorded(capture, old.root)) == json.dumps(old.record["capture"]):
        return f"sequence {old.name} is unchanged"
    kept = f", and its partitions of {old.partition_frames} frames" if old.partition_frames != length else ""
    return f"sequence {old.name} was registered before; its results are kept where they still hold{kept}"


def _copied_whole(capture: Capture, root: Path) -> Capture:
    """The capture with its files copied into a sequence's folder; of a sequence that is new nothing is left where
    they do not fit."""
    new = not root.exists()
    refuse_links(root / SOURCES)
    try:
        return _copied(capture, root / SOURCES)
    except NotWritten:
        if new:
            shutil.rmtree(root, ignore_errors=True)
        raise


def _copied(capture: Capture, folder: Path) -> Capture:
    """The capture with every file copied below a folder."""

    shared: dict[str, SourceFile] = {}  # one file may hold all cameras

    def stream(s: Stream | None, kind: str, owner: str) -> Stream | None:
        if s is None:
            return None
        place = folder / kind / owner
        copies = []
        for f, name in zip(s.files, _names_of(s), strict=True):
            if f.path not in shared:
                shared[f.path] = _copy(f, place / name)
            copies.append(shared[f.path])
        return dataclasses.replace(s, files=tuple(copies))

    names = capture.rig.names
    kinds = {k: tuple(stream(s, k, n) for s, n in zip(capture.streams(k), names, strict=False)) for k in PER_VIEW}
    return dataclasses.replace(capture, joints3d=stream(capture.joints3d, "joints3d", "all"), **kinds)  # type: ignore[arg-type]


def _names_of(stream: Stream) -> list[str]:
    """A name for the copy of each of a stream's files: its own, or its frame's number where two are called alike, as in
    000000/cam1.png and 000001/cam1.png."""
    names = [Path(f.path).name for f in stream.files]
    if len(set(names)) == len(names):
        return names
    return [f"{n:06d}{Path(name).suffix}" for n, name in zip(stream.numbers, names, strict=True)]


def _copy(file: SourceFile, target: Path) -> SourceFile:
    try:
        with whole_file(target, file.size) as partial:
            shutil.copy2(file.path, partial)
    except NotWritten:
        raise
    except OSError as e:
        raise SourceError(f"cannot copy {file.path} to {target}: {e.strerror}") from e
    return SourceFile.of(target)
