"""Joint files of other people: OpenPose, COCO and EasyMocap JSON and Caliscope's CSV (2D) and TRC (3D), read into our
pixel centres and axes.

2D formats place the centre of the top-left pixel at (0, 0) unless a COCO file says `"pixel_center": "half"`.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from posegaussian.storage.model.cameras import points_from_integer_centres
from posegaussian.storage.model.documents import MOST_DIGITS, read_json, read_table, read_text, shortened, whole
from posegaussian.storage.model.errors import SourceError
from posegaussian.storage.model.plausible import check_joints3d, check_pixels, check_scores, check_time


class Detections(NamedTuple):
    """The people found in one picture, in our pixel centres."""

    joints: np.ndarray
    """[people, J, 3] float64 (u, v, score); a missing joint has score 0."""
    boxes: np.ndarray
    """[people, 5] float64 (left, top, right, bottom, score) px; score 0 where the file gives no box."""


def no_people(joints: int) -> Detections:
    """Zero people with that many joints."""
    return Detections(np.zeros((0, joints, 3)), np.zeros((0, 5)))


def frame_number(path: str | Path) -> int | None:
    """The last group of digits in a file's name (cam01_000012_keypoints.json -> 12), or None without digits. Raises
    SourceError for one beyond 64 bits."""
    digits = re.findall(r"[0-9]+", re.sub(r"_keypoints(2d|3d)?$", "", Path(path).stem))
    if digits and len(digits[-1].lstrip("0")) > MOST_DIGITS:
        raise SourceError(f"{path}: a frame number of {len(digits[-1])} digits; at most {MOST_DIGITS} are read")
    return int(digits[-1]) if digits else None


def joint_rows(flat: Any, path: str | Path, what: str, half: bool) -> np.ndarray:
    """[J, 3] float64 (u, v, score) px, our centres, from 3 J numbers or J triples, whose centres are ours with `half`.

    Values that are not finite make the joint missing, scores are clipped to 0..1. Raises SourceError, naming `path` and
    `what`.
    """
    try:
        values = np.array(flat, dtype=np.float64).reshape(-1)
    except (TypeError, ValueError):
        raise SourceError(f"{path}: {what} is not a list of numbers") from None
    if values.size % 3:
        raise SourceError(f"{path}: {what} has {values.size} numbers, which are not (x, y, score) triples")
    out = values.reshape(-1, 3)
    out[~np.isfinite(out).all(axis=1)] = 0
    check_pixels(str(path), what, out[:, :2])
    check_scores(str(path), what, out[:, 2])
    out[:, 2] = np.clip(out[:, 2], 0, 1)
    if not half:
        out[:, :2] = points_from_integer_centres(out[:, :2])
    return out


def _box(corners: Any, score: Any, path: str | Path, half: bool) -> np.ndarray:
    """[5] from (left, top, right, bottom) and a score."""
    try:
        values = np.array([*corners, score], dtype=np.float64).reshape(5)
    except (TypeError, ValueError):
        values = np.full(5, np.nan)
    if not np.isfinite(values).all():
        raise SourceError(f"{path}: bbox {shortened(corners)} with score {shortened(score)} is not made of numbers")
    check_pixels(str(path), "bbox", values[:4])
    check_scores(str(path), "bbox", values[4:])
    return np.array([*(values[:4] if half else points_from_integer_centres(values[:4])), values[4]])


def _gather(people: list[np.ndarray], boxes: list[np.ndarray], path: str | Path) -> Detections:
    counts = {len(p) for p in people}
    if len(counts) > 1:
        raise SourceError(f"{path}: people have different numbers of joints ({', '.join(map(str, sorted(counts)))})")
    return Detections(
        np.stack(people) if people else np.zeros((0, 0, 3)), np.stack(boxes) if boxes else np.zeros((0, 5))
    )


def _list(data: Any, key: str, path: str | Path) -> list[dict[str, Any]]:
    items = data.get(key) if isinstance(data, dict) else None
    if not isinstance(items, list) or not all(isinstance(i, dict) for i in items):
        raise SourceError(f"{path} has no list {key!r} of objects")
    return items


def _items(value: Any, what: str, path: str | Path) -> Sequence[Any]:
    """The value, which must be a list."""
    if not isinstance(value, list | tuple):
        raise SourceError(f"{path}: {what} {shortened(value)} is not a list of numbers")
    return value


def read_openpose(path: str | Path) -> Detections:
    """One picture's OpenPose JSON; a person without `pose_keypoints_2d` is no person. Raises SourceError."""
    flats = [p.get("pose_keypoints_2d") for p in _list(read_json(path), "people", path)]
    people = [joint_rows(f, path, "pose_keypoints_2d", False) for f in flats if f]
    return _gather(people, [np.zeros(5) for _ in people], path)


def read_easymocap(path: str | Path) -> Detections:
    """One picture's EasyMocap `annots` JSON:
    keypoints and, where given, bbox (l, t, r, b, score). Raises SourceError."""
    annots = [a for a in _list(read_json(path), "annots", path) if a.get("keypoints")]
    given = [[*_items(a.get("bbox") or (), "bbox", path), 1.0] for a in annots]
    boxes = [_box(b[:4], b[4], path, half=False) if len(b) > 4 else np.zeros(5) for b in given]
    return _gather([joint_rows(a["keypoints"], path, "keypoints", False) for a in annots], boxes, path)


def read_coco(path: str | Path, view: str | None = None) -> dict[int, Detections]:
    """People by frame number of a COCO keypoints JSON, one view's where `file_name` has the view's folder.

    The frame number is the last group of digits of `images[].file_name`. The third number of a joint is its score, a
    visibility of 1 or 2 counts as 1; `keypoint_scores` [J], where given, goes before it. `"pixel_center": "half"` at
    the top says that coordinates are in our pixel centres. Raises SourceError.
    """
    data = read_json(path)
    half = isinstance(data, dict) and _pixel_center(data.get("pixel_center", "integer"), path) == "half"
    images: dict[Any, int] = {}
    for image in _list(data, "images", path):
        name = Path(str(image.get("file_name", "")))
        number = frame_number(name)
        if number is None:
            raise SourceError(f"{path}: file_name {str(name)!r} holds no frame number")
        if view is None or view in name.parts[:-1]:
            images[_id(image.get("id"), path)] = number
    annotations: dict[int, list[dict[str, Any]]] = {n: [] for n in images.values()}
    for a in _list(data, "annotations", path):
        if _id(a.get("image_id"), path) in images and a.get("keypoints"):
            annotations[images[a["image_id"]]].append(a)
    return {n: _coco_people(found, path, half) for n, found in annotations.items()}


def _id(value: Any, path: str | Path) -> Any:
    """An image's id: a number or a text."""
    if isinstance(value, list | dict):
        raise SourceError(f"{path}: the image id {shortened(value)} is neither a number nor a text")
    return value


def _coco_people(found: list[dict[str, Any]], path: str | Path, half: bool) -> Detections:
    people = [joint_rows(a["keypoints"], path, "keypoints", half) for a in found]
    for a, joints in zip(found, people, strict=True):
        scores = a.get("keypoint_scores")
        if scores is None:
            continue
        if len(_items(scores, "keypoint_scores", path)) != len(joints):
            raise SourceError(f"{path}: keypoint_scores has {len(scores)} values for {len(joints)} joints")
        joints[:, 2] = joint_rows([(0, 0, s) for s in scores], path, "keypoint_scores", half)[:, 2]
    return _gather(people, [_coco_box(a, path, half) for a in found], path)


def _coco_box(a: dict[str, Any], path: str | Path, half: bool) -> np.ndarray:
    """[5] of an annotation's bbox (left, top, width, height), zero without one."""
    given = _items(a.get("bbox") or (), "bbox", path)
    if not given:
        return np.zeros(5)
    if len(given) != 4 or not all(isinstance(n, int | float) for n in given):
        raise SourceError(f"{path}: bbox {shortened(given)} is not made of four numbers")
    x, y, w, h = given
    return _box((x, y, x + w, y + h), a.get("score", 1.0), path, half)


def _pixel_center(value: Any, path: str | Path) -> str:
    if value not in ("integer", "half"):
        raise SourceError(f"{path}: pixel_center is {value!r}; it must be 'integer' or 'half'")
    return value


class TrackedFrame(NamedTuple):
    """What Caliscope says about one picture in which it tracked landmarks."""

    frame_index: int
    """Frame of the video, in newer versions."""
    frame_time: float
    """Seconds."""
    points: dict[int, tuple[float, float]]
    """{landmark: (x, y)} px, pixel centres at integers."""


def read_tracked(path: str | Path) -> dict[int, dict[int, TrackedFrame]]:
    """{camera: {sync_index: frame}} of Caliscope's `xy_TRACKER.csv`. Raises SourceError with path, line and cause."""
    out: dict[int, dict[int, TrackedFrame]] = {}
    columns, rows = read_table(path)
    camera, point = (
        next((k for k in keys if k in columns), keys[0]) for keys in (("cam_id", "port"), ("point_id", "keypoint_id"))
    )
    lacking = {"sync_index", camera, "frame_index", "frame_time", point, "img_loc_x", "img_loc_y"} - set(columns)
    if lacking:
        raise SourceError(
            f"{path} lacks the columns {', '.join(sorted(lacking))}; track the recording with Caliscope again"
        )
    for line, row in rows:
        try:
            frame = TrackedFrame(whole(row["frame_index"]), float(row["frame_time"]), {})
            check_time(f"{path} line {line}", frame.frame_time)
            found = out.setdefault(whole(row[camera]), {}).setdefault(whole(row["sync_index"]), frame)
            found.points[whole(row[point])] = (float(row["img_loc_x"]), float(row["img_loc_y"]))
        except (TypeError, ValueError, AttributeError) as e:
            raise SourceError(f"{path} line {line}: {e}") from e
    return out


def read_caliscope(path: str | Path, camera: int, joints: int) -> dict[int, Detections]:
    """The one person of a camera by sync_index, landmarks 0 to J-1; Caliscope keeps no scores, so a landmark it has
    counts as 1. Raises SourceError."""
    out = {}
    for sync, frame in read_tracked(path).get(camera, {}).items():
        flat = [(*frame.points[j], 1.0) if j in frame.points else (np.nan, np.nan, 0.0) for j in range(joints)]
        people = joint_rows(flat, path, "landmarks", half=False)[None]
        out[sync] = Detections(people, np.zeros((1, 5))) if people[..., 2].any() else no_people(joints)
    return out


@dataclass(frozen=True, eq=False)
class TrcFile:
    """A TRC file as it is written, in metres."""

    markers: tuple[str, ...]
    """Marker names in file order."""
    numbers: np.ndarray
    """[F] int 0-based source frame numbers: `Frame#` minus one, unless the file counts from 0."""
    points: np.ndarray
    """[F, M, 3] metres, file axes; NaN where a marker is missing."""
    rate: float
    """DataRate, 1/s."""

    def joints(self, names: Iterable[str], axes: str) -> Mapping[int, np.ndarray]:
        """{number: [J, 4] (x, y, z, score) in world metres} of the named markers.

        `axes` says which world axes the file's columns hold: "yzx" means that file (x, y, z) = world (Y, Z, X).
        """
        chosen = [self.markers.index(n) for n in names]
        world = np.empty((len(self.numbers), len(chosen), 3))
        for column, axis in enumerate(axes):
            world[..., "xyz".index(axis)] = self.points[:, chosen, column]
        score = np.isfinite(world).all(axis=-1, keepdims=True)
        out = np.concatenate([np.where(score, world, 0.0), score.astype(np.float64)], axis=-1)
        return dict(zip(self.numbers.tolist(), out, strict=True))


_UNITS = {"m": 1.0, "mm": 1e-3, "cm": 1e-2}


def read_trc(path: str | Path) -> TrcFile:
    """Read a TRC file (OpenSim: 5 header lines, tab separated). Raises SourceError with path, line and cause."""
    lines = read_text(path).splitlines()
    if len(lines) < 6 or not lines[0].startswith("PathFileType"):
        raise SourceError(
            f"{path} is not a TRC file: its first line must start with PathFileType and data follow 5 header lines"
        )
    header = dict(zip(lines[1].split("\t"), lines[2].split("\t"), strict=False))
    unit = header.get("Units", "").strip()
    if unit not in _UNITS:
        raise SourceError(f"{path}: unit {unit!r} is not one of {', '.join(_UNITS)}")
    markers = tuple(n for n in lines[3].split("\t")[2:] if n.strip())
    if not markers or len(set(markers)) < len(markers):
        raise SourceError(f"{path}: line 4 must name each marker once, found {len(markers)} names")
    rows, frames = [], []
    for at, line in enumerate(lines[5:], start=6):
        cells = [c.strip() for c in line.split("\t")]
        if not any(cells):
            continue
        values = cells[2 : 2 + 3 * len(markers)]
        try:
            frames.append(whole(f"{float(cells[0]):.0f}"))
            rows.append([float(c) if c else np.nan for c in values] + [np.nan] * (3 * len(markers) - len(values)))
        except ValueError as e:
            raise SourceError(f"{path} line {at}: {e}") from e
    numbers = np.array(frames, dtype=np.int64)
    if len(numbers) == 0 or (np.diff(numbers) <= 0).any():
        raise SourceError(f"{path}: frame numbers must ascend, found {len(numbers)} frames")
    points = np.array(rows).reshape(len(rows), len(markers), 3) * _UNITS[unit]
    check_joints3d(str(path), points)
    try:
        rate = float(header.get("DataRate", "0"))
    except ValueError:
        raise SourceError(f"{path}: DataRate {header['DataRate']!r} is not a number") from None
    return TrcFile(markers, numbers - min(1, int(numbers[0])), points, rate)
