"""Captures as Pose2Sim leaves them: videos, a TOML or Qualisys calibration, OpenPose joints, TRC files, wherever they
lie.

A camera is named after its video, or the folder that holds only that one. Its calibration is the table of that name,
`int_NAME_img`, one whose `name` says so, or Caliscope's `cameras.N` where the video's name ends in N. Calibration and
joints put pixel centres at integers.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pydantic import Field

from posegaussian.storage.formats.joint_files import read_openpose
from posegaussian.storage.importers.caliscope import unread_times
from posegaussian.storage.importers.camera_folders import has_camera_folders, videos_of
from posegaussian.storage.importers.cameras import build_rig
from posegaussian.storage.importers.common import (
    ImportOptions,
    all_below,
    chosen,
    folder,
    natural,
    numbered,
    shown,
    subfolders,
    videos_in,
)
from posegaussian.storage.importers.declaration import Importer, Trait, or_broken
from posegaussian.storage.importers.films import video_streams
from posegaussian.storage.importers.joint_streams import picture_joints, trc_joints
from posegaussian.storage.importers.qualisys import is_qualisys, qualisys_tables
from posegaussian.storage.importers.toml_cameras import table_camera, toml_tables
from posegaussian.storage.model.capture import Capture, Stream
from posegaussian.storage.model.documents import read_json
from posegaussian.storage.model.errors import CalibrationError, SourceError


class Pose2SimOptions(ImportOptions):
    """What to take where several files fit; paths are relative to the capture's folder."""

    videos: str | None = Field(None, description="Folder of the videos.")
    calibration: str | None = Field(None, description="Calibration file (*.toml, or Qualisys' *.qca.txt).")
    joints: str | None = Field(None, description="Folder with one folder of OpenPose JSON a camera.")
    trc: str | None = Field(None, description="TRC file of 3D joints.")
    trc_axes: str = Field(
        "yzx",
        pattern="^(xyz|xzy|yxz|yzx|zxy|zyx)$",
        description="World axes that the TRC's x, y, z columns hold; Pose2Sim writes yzx.",
    )


def find(source: Path, options: Pose2SimOptions) -> Capture:
    """Find everything in a folder and below.
    Raises SourceError or CalibrationError, each a sentence with the next step."""
    base = folder(source)
    path, tables = _calibration(base, options)
    notes = [f"calibration: {shown(base, [path])}"]
    videos = _videos(base, options, tables)
    matched: dict[str, str] = {}
    for name in videos:
        key = _table_of(name, tables)
        if key is None:
            raise CalibrationError(
                f"video {videos[name]} has no calibration in {path.name}, which holds {', '.join(tables)}; rename it,"
                " take it out, or list the wanted ones in the option cameras"
            )
        if key in matched.values():
            raise CalibrationError(
                f"calibration {key} of {path.name} fits two videos, {name} and"
                f" {next(n for n in matched if matched[n] == key)}; rename one"
            )
        matched[name] = key
    names = tuple(videos)
    notes += [
        f"calibration {key} has no video and is left out"
        for key in tables
        if key not in matched.values() and options.cameras is None
    ]
    pictures, rate, more = video_streams(videos, options.frame_rate)
    notes += [*more, *unread_times([base, *(v.parent for v in videos.values())])]
    rig = build_rig([table_camera(n, tables[matched[n]]) for n in names], [s.size for s in pictures], half=False)
    joints, more = _joints(base, options, names, pictures)
    notes += more
    joints3d, more = _joints3d(base, options)
    return Capture("pose2sim", rig, rate, tuple(pictures), joints=joints, joints3d=joints3d, notes=(*notes, *more))


def _calibration(base: Path, options: Pose2SimOptions) -> tuple[Path, dict[str, Mapping[str, Any]]]:
    """The one file with camera tables: TOML, or Qualisys' own where it is chosen or there is no TOML; unreadable
    ones count only where nothing else is found."""
    given = chosen(base, options.calibration, "calibration")
    found: dict[Path, dict[str, Mapping[str, Any]]] = {}
    broken: list[CalibrationError] = []
    everything = [p for p in all_below(base) if p.is_file()]
    for paths in (
        [[given]]
        if given
        else [[p for p in everything if p.suffix == ".toml"], [p for p in everything if is_qualisys(p)]]
    ):
        for path in paths if not found else []:
            try:
                if tables := (qualisys_tables if is_qualisys(path) else toml_tables)(path):
                    found[path] = tables
            except CalibrationError as e:
                broken.append(e)
    if not found:
        raise (
            broken[0]
            if broken
            else CalibrationError(
                f"no calibration in {given or base}: no *.toml with a camera's matrix,"
                " rotation and translation, no *.qca.txt"
            )
        )
    if len(found) > 1:
        raise CalibrationError(
            f"several calibrations fit: {shown(base, found)}; choose one with the option calibration"
        )
    path, tables = next(iter(found.items()))
    usable = {k: t for k, t in tables.items() if not t.get("ignore")}
    if not usable:
        raise CalibrationError(f"every camera of {path} is set to ignore")
    return path, usable


def _named(name: str, tables: Mapping[str, Mapping[str, Any]]) -> str | None:
    """Key of the calibration table that has a camera's name."""
    for wanted in (name, f"int_{name}_img"):
        for key, table in tables.items():
            if wanted in (key, key.partition(".")[2], str(table.get("name"))):
                return key
    return None


def _table_of(name: str, tables: Mapping[str, Mapping[str, Any]]) -> str | None:
    """Key of the calibration table of a video."""
    if (named := _named(name, tables)) is not None:
        return named
    index = re.search(r"(\d+)$", name)
    for key in tables if index else ():
        number = re.fullmatch(r"(?:cameras\.|cam_?|port_?)?(\d+)", key)
        if number and index and int(number[1]) == int(index[1]):
            return key
    return None


def _videos(base: Path, options: Pose2SimOptions, tables: Mapping[str, Mapping[str, Any]]) -> dict[str, Path]:
    """{camera: video} of the one folder whose videos, or folders with a video each, the calibration knows."""
    given = chosen(base, options.videos, "videos")
    folders = [given] if given else [base, *sorted((p for p in all_below(base) if p.is_dir()), key=natural)]
    found = {f: v for f in folders if (v := videos_in(f))}
    named = {f for f in folders if has_camera_folders(f, lambda name: _named(name, tables) is not None)}
    if not found and not named:
        raise SourceError(f"no video in {given or base} or below")
    known = {f for f, v in found.items() if any(_table_of(n, tables) for n in v)}
    if len(known) > 1:
        known = {f for f in known if f.name == "videos"} or known
    if len(known) != 1:
        known = named or known or set(found)
    if len(known) > 1:
        fitting = shown(base, [f for f in folders if f in known])
        raise SourceError(f"several folders hold videos: {fitting}; choose one with the option videos")
    videos = videos_of(next(iter(known)), lambda name: _named(name, tables) is not None)
    return {n: videos[n] for n in options.pick(tuple(videos))}


def _joint_folders(parent: Path, names: Sequence[str]) -> dict[str, Path]:
    """{camera: folder with JSON}: `NAME`, or `NAME_...` such as `NAME_json`."""
    out: dict[str, Path] = {}
    for sub in subfolders(parent):
        fitting = [n for n in names if sub.name == n or sub.name.startswith(f"{n}_")]
        first = next((p for p in all_below(sub) if p.suffix == ".json"), None) if fitting else None
        if first is not None and isinstance(data := read_json(first), dict) and "people" in data:
            out.setdefault(max(fitting, key=len), sub)
    return out


def _joints(
    base: Path, options: Pose2SimOptions, names: Sequence[str], pictures: Sequence[Stream]
) -> tuple[tuple[Stream | None, ...], list[str]]:
    given = chosen(base, options.joints, "joints")
    parents = [given] if given else [base, *sorted((p for p in all_below(base) if p.is_dir()), key=natural)]
    found = {p: f for p in parents if (f := _joint_folders(p, names))}
    if not found:
        if given:
            raise SourceError(f"option joints: {given} has no folder of OpenPose JSON for any of {', '.join(names)}")
        return (), ["no 2D joints"]
    if len(found) > 1:
        raise SourceError(f"several folders hold joints: {shown(base, found)}; choose one with the option joints")
    parent, folders = next(iter(found.items()))
    files = {n: numbered(f, (".json",)) for n, f in folders.items()}
    return picture_joints("openpose", read_openpose, names, files, pictures, options.joint_set, parent.name)


def _joints3d(base: Path, options: Pose2SimOptions) -> tuple[Stream | None, list[str]]:
    """3D joints of the one TRC file; several are left out unless one is chosen."""
    given = chosen(base, options.trc, "trc")
    found = [p for p in all_below(base) if p.suffix == ".trc"]
    if given is None and len(found) > 1:
        return None, [f"{len(found)} TRC files fit, none is used; choose one with the option trc: {shown(base, found)}"]
    if given is None and not found:
        return None, []
    path = given or found[0]
    try:
        stream = trc_joints(path, options.trc_axes)
    except SourceError as e:
        if given:
            raise
        return None, [f"3D joints are left out: {e}"]
    return stream, [f"3D joints: {path.name}, joint set {stream.options['joint_set']}"]


def _has_camera_tables(base: Path) -> bool:
    return any(
        is_qualisys(p) or (p.suffix == ".toml" and or_broken(lambda p=p: toml_tables(p)))  # type: ignore[misc]
        for p in all_below(base)
        if p.is_file()
    )


def _has_videos(base: Path) -> bool:
    return or_broken(lambda: any(videos_in(f) for f in (base, *(p for p in all_below(base) if p.is_dir()))))


IMPORTER = Importer(
    "pose2sim",
    "Videos, a TOML or Qualisys calibration and OpenPose joints, as Pose2Sim has them.",
    Pose2SimOptions,
    find,
    (
        Trait("calibration *.toml with a camera's matrix, or *.qca.txt of Qualisys", _has_camera_tables),
        Trait("videos in the folder or below", _has_videos, filmed=True),
    ),
    general=True,  # what Caliscope leaves, this importer could read, too
    by_definition=True,
)
