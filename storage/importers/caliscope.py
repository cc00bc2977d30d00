"""Recordings as Caliscope leaves them: `cam_N.mp4`, `timestamps.csv` and the workspace's `camera_array.toml`.

Which frames of the videos belong together is told by `timestamps.csv`: frame k of a video is the k-th row of its camera
in order of `frame_time`; rows of one `sync_index` are one instant, and where the file has no such column (newer
versions) frames are matched by time. Frame n of the capture is the n-th instant. Older names (`port_N.mp4`,
`frame_time_history.csv`, `port`) are read, too. Pixel centres lie at integers; landmarks of Caliscope's trackers
(`xy_TRACKER.csv`) become 2D joints.
Format: https://github.com/mprib/caliscope, docs/project_setup.md.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from pydantic import Field

from posegaussian.storage.importers.caliscope_joints import tracked_joints
from posegaussian.storage.importers.caliscope_times import Instants, instants
from posegaussian.storage.importers.cameras import build_rig
from posegaussian.storage.importers.common import ImportOptions, all_below, chosen, folder, shown, videos_in
from posegaussian.storage.importers.declaration import Importer, Trait, or_broken
from posegaussian.storage.importers.toml_cameras import table_camera, toml_tables
from posegaussian.storage.model.capture import Capture, SourceFile, Stream
from posegaussian.storage.model.errors import CalibrationError, SourceError
from posegaussian.storage.readers.video import VideoFile

CALIBRATION = "camera_array.toml"
"""Name of the calibration, wherever it lies."""
TIMES = ("timestamps.csv", "frame_time_history.csv")
"""Names of the table of frame times, the newer first."""
_BOARD = ("xy.csv", "point_data.csv", "image_points.csv", "stereotriangulated_points.csv", "world_points.csv")
"""Corners of the calibration board, in 2D and 3D."""
_RATE_TOLERANCE = 0.01


class CaliscopeOptions(ImportOptions):
    """What to take where several files fit; paths are relative to the recording's folder."""

    calibration: str | None = Field(
        None,
        description="Calibration file; by default camera_array.toml beside the videos, below them, or the workspace's.",
    )
    tracker: str | None = Field(
        None,
        description=(
            "Tracker whose landmarks become 2D joints, by the name of its folder;"
            " by default the one whose joints are known."
        ),
    )


def find(source: Path, options: CaliscopeOptions) -> Capture:
    """Find everything of one recording. Raises SourceError or CalibrationError, each a sentence with the next step."""
    base = folder(source)
    videos = _videos(base, options)
    path = _calibration(base, options)
    tables = _tables(tuple(videos), path)
    opened = {_id(name): VideoFile(video) for name, video in videos.items()}
    times = next((base / name for name in TIMES if (base / name).is_file()), None)
    matched = instants(times, opened)
    rate, more = _rate(options, opened, matched)
    pictures = [_stream(video, opened[_id(name)], matched.frames[_id(name)]) for name, video in videos.items()]
    rig = build_rig([table_camera(name, t) for name, t in tables.items()], [s.size for s in pictures], half=False)
    joints, found = tracked_joints(
        base, {n: _id(n) for n in rig.names}, matched, pictures, options.tracker, options.joint_set
    )
    notes = [
        f"calibration: {shown(base, [path])}",
        *matched.notes,
        *more,
        *_turned(tables),
        *_left_out(base),
        *found,
    ]
    return Capture("caliscope", rig, rate, tuple(pictures), joints=joints, notes=tuple(notes))


def _id(name: str) -> int:
    """Caliscope's number of a camera, from its video's name."""
    return int(name.rpartition("_")[2])


def _recorded(path: Path) -> dict[str, Path]:
    """{camera: video} of one folder. Raises SourceError for two videos of one number."""
    found = {name: video for name, video in videos_in(path).items() if re.fullmatch(r"(cam|port)_\d+", name)}
    for name, video in found.items():
        if (other := next(n for n in found if _id(n) == _id(name))) != name:
            raise SourceError(
                f"two videos are camera {_id(name)}: {found[other].name} and {video.name}; take one out of {path}"
            )
    return found


def recordings(base: Path) -> dict[Path, dict[str, Path]]:
    """{folder: {camera: video}} of the recordings in a folder and below.
    Raises SourceError for two videos of one number."""
    return {f: v for f in [base, *(p for p in all_below(base) if p.is_dir())] if (v := _recorded(f))}


def _videos(base: Path, options: CaliscopeOptions) -> dict[str, Path]:
    """{camera: video} of the recording in the folder, or in the only one below it."""
    found = recordings(base)
    if not found:
        raise SourceError(f"no video cam_N.mp4 in {base} or below; give the folder of one recording")
    if base not in found:
        raise SourceError(f"{base} holds recordings in {shown(base, found)}; give one of these folders")
    return {name: found[base][name] for name in options.pick(tuple(found[base]))}


def calibration_files(base: Path) -> list[Path]:
    """Every camera_array.toml below a folder, then those of the workspace above it."""
    below = sorted((p for p in all_below(base) if p.name == CALIBRATION), key=lambda p: len(p.parts))
    above = [
        p / part / CALIBRATION
        for p in base.parents[:3]
        for part in ("calibration/extrinsic/capture_volume", "calibration/extrinsic", "")
    ]
    return [*below, *(p for p in above if p.is_file())]


def _calibration(base: Path, options: CaliscopeOptions) -> Path:
    """The chosen file, or the first camera_array.toml: beside the videos, with a tracker's results below them, of
    the workspace above."""
    if given := chosen(base, options.calibration, "calibration"):
        return given
    found = calibration_files(base)
    below = [p for p in found if p.is_relative_to(base)]
    if not found:
        raise CalibrationError(
            f"no {CALIBRATION} in {base}, below it or in its workspace; calibrate with Caliscope, or name the file with"
            " the option calibration"
        )
    if base / CALIBRATION not in found and len({p.read_bytes() for p in below}) > 1:
        raise CalibrationError(
            f"several calibrations fit: {shown(base, below)}; choose one with the option calibration"
        )
    return found[0]


def _tables(names: tuple[str, ...], path: Path) -> dict[str, Mapping[str, Any]]:
    """{camera: its table}. Raises CalibrationError for a camera that has none or is set to ignore."""
    tables = toml_tables(path)
    keys = {int(found[1]): k for k in tables if (found := re.fullmatch(r"(?:cameras\.|cam_|port_)(\d+)", k))}
    for name in names:
        if _id(name) not in keys:
            raise CalibrationError(
                f"camera {name} has no calibration in {path}, which holds {', '.join(tables) or 'no camera'}; list the"
                " wanted cameras in the option cameras"
            )
        if tables[keys[_id(name)]].get("ignore"):
            raise CalibrationError(
                f"camera {name} is set to ignore in {path}; list the wanted cameras in the option cameras"
            )
    return {name: tables[keys[_id(name)]] for name in names}


def _stream(path: Path, video: VideoFile, frames: Mapping[int, int]) -> Stream:
    """The pictures of a view: {instant: frame of its video}."""
    numbers, indices = tuple(frames), list(frames.values())
    return Stream(
        "video", (SourceFile.of(path),), numbers, video.size, {} if indices == list(numbers) else {"indices": indices}
    )


def _rate(options: CaliscopeOptions, videos: Mapping[int, VideoFile], matched: Instants) -> tuple[float, list[str]]:
    """(frames per second, notes): as asked for, else that of the instants;
    a video's round figure where it is the same."""
    if options.frame_rate is not None:
        return options.frame_rate, []
    nominal = max(v.rate for v in videos.values())
    rate = matched.rate or nominal
    if rate <= 0:
        raise SourceError("neither the videos nor the times give a frame rate; set frame_rate")
    if abs(rate - nominal) <= _RATE_TOLERANCE * nominal:
        return nominal, []
    return rate, [f"the times say {rate:.4g} frames/s, the videos {nominal:g}; the times are believed"]


def _turned(tables: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Sentences about cameras that Caliscope shows turned: their calibration is of the picture as filmed."""
    turns = {n: t.get("rotation_count", 0) for n, t in tables.items()}
    return [
        f"camera {n} is shown turned by {90 * t} degrees in Caliscope; its pictures are used as filmed"
        for n, t in turns.items()
        if t
    ]


def _left_out(base: Path) -> list[str]:
    found = [base / name for name in _BOARD if (base / name).is_file()]
    return [f"corners of the calibration board are no joints and are left out: {shown(base, found)}"] if found else []


def unread_times(folders: Iterable[Path]) -> list[str]:
    """What another layout says of a table of times that lies in one of the folders of its videos: it is not read, and
    what reads it."""
    table = next((f / name for f in folders for name in TIMES if (f / name).is_file()), None)
    if table is None:
        return []
    base = table.parent
    reads = (
        f"posegaussian import caliscope {shlex.quote(str(base))} reads it"
        if or_broken(lambda: base in recordings(base)) and calibration_files(base)
        else f"the layout caliscope reads it, beside videos cam_N.mp4 and with a {CALIBRATION}"
    )
    return [f"{table.name} is not read by this layout, so frames are not matched by its times; {reads}"]


IMPORTER = Importer(
    "caliscope",
    "Videos cam_N.mp4, timestamps.csv and camera_array.toml, as Caliscope leaves them.",
    CaliscopeOptions,
    find,
    (
        Trait("videos cam_N.mp4", lambda base: or_broken(lambda: recordings(base)), filmed=True),
        Trait(f"{CALIBRATION} beside them, below, or in the workspace", lambda base: bool(calibration_files(base))),
    ),
    by_definition=True,
    timed=True,
)
