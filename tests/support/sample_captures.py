"""A small rig and a capture without files, for tests that never open a source."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from posegaussian.storage.archive.store import Archive, SequenceGroup
from posegaussian.storage.model.cameras import Rig, rigid
from posegaussian.storage.model.capture import Capture, SourceFile, Stream


def make_rig(views: int = 3, width: int = 40, height: int = 30) -> Rig:
    """Cameras on a circle of 3 m that look at the origin, y down."""
    motions = []
    for v in range(views):
        a = 2 * np.pi * v / views
        motions.append(rigid([[np.cos(a), 0, -np.sin(a)], [0, 1, 0], [np.sin(a), 0, np.cos(a)]], [0, 0, 3]))
    intrinsics = np.tile(np.array([[50.0, 0, width / 2], [0, 50.0, height / 2], [0, 0, 1]]), (views, 1, 1))
    names = tuple(f"cam{v + 1:02d}" for v in range(views))
    return Rig(
        names, intrinsics, np.zeros((views, 8)), np.stack(motions), np.tile(np.array([width, height]), (views, 1))
    )


def fake_file(name: str) -> SourceFile:
    return SourceFile(f"/nowhere/{name}", f"{abs(hash_of(name)):064x}", 1234, 1_700_000_000_000_000_001)


def hash_of(name: str) -> int:
    """A number that is the same in every process, unlike `hash`."""
    return int.from_bytes(name.encode(), "big")


def make_capture(views: int = 3, numbers: range = range(10), joints: bool = True, masks: bool = True) -> Capture:
    """Pictures frame by frame, masks and OpenPose joints; no file exists."""
    rig = make_rig(views)

    def streams(kind: str, what: str, **options: str) -> tuple[Stream, ...]:
        return tuple(
            Stream(kind, tuple(fake_file(f"{n}-{what}-{i}") for i in numbers), tuple(numbers), (40, 30), options)
            for n in rig.names
        )  # type: ignore[arg-type]

    return Capture(
        "images",
        rig,
        25.0,
        streams("images", "c"),
        masks=streams("images", "m") if masks else (),
        joints=streams("openpose", "j", joint_set="body25") if joints else (),
        notes=("found 3 cameras", "chose the first"),
    )


def make_sequence(folder: Path, views: int = 3, partition_frames: int = 4, numbers: range = range(10)) -> SequenceGroup:
    """An archive in `folder` with one sequence named `kick`."""
    return Archive.open(str(folder), create=True).create_sequence(
        "kick", make_capture(views, numbers), partition_frames
    )
