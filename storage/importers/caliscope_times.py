"""Which frames of Caliscope's videos belong to one instant."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from posegaussian.storage.model.documents import read_table, whole
from posegaussian.storage.model.errors import SourceError
from posegaussian.storage.model.plausible import check_time
from posegaussian.storage.readers.video import VideoFile


class Instants(NamedTuple):
    """The instants of a recording, numbered from 0 in order of time."""

    frames: dict[int, dict[int, int]]
    """{camera: {instant: 0-based frame of its video}}, ascending; an instant that a camera missed is not there."""
    times: dict[int, list[float]]
    """{camera: frame_time of each frame of its video}, empty where there is no table."""
    rate: float
    """Instants a second, 0 where nothing tells."""
    notes: list[str]
    """What the frames were matched by, and how well."""


class _Row(NamedTuple):
    sync: int | None
    time: float


def instants(table: Path | None, videos: Mapping[int, VideoFile]) -> Instants:
    """Match the frames of all videos by the table of times; without one, videos of equal length are taken to start
    together.

    Raises SourceError for a table that cannot be read, that has another number of rows than a video has frames, or that
    is missing while the videos differ in length.
    """
    if table is None:
        counts = {f"camera {c}": v.count for c, v in videos.items()}
        if len(set(counts.values())) > 1:
            raise SourceError(
                "there is no timestamps.csv, and the videos have"
                f" {', '.join(f'{n} frames ({c})' for c, n in counts.items())};"
                " add the file, or cut all videos to the same instants"
            )
        return Instants(
            {c: {n: n for n in range(v.count)} for c, v in videos.items()},
            {},
            0.0,
            ["no timestamps.csv: frame n of each video is taken as one instant"],
        )
    rows = _rows(table)
    for camera, video in videos.items():
        found = len(rows.get(camera, ()))
        if found != video.count:
            raise SourceError(
                f"{table} has {found} rows of camera {camera}, its video {video.path} has {video.count} frames; put the"
                " file of this recording there"
            )
    used = {c: rows[c] for c in videos}
    by_index = all(r.sync is not None for found in used.values() for r in found)
    groups = _by_index(used, table) if by_index else _by_time(used)
    return _described(groups, used, f"frames are matched by {'sync_index' if by_index else 'time'} of {table.name}")


def _rows(table: Path) -> dict[int, list[_Row]]:
    """{camera: rows in order of time}. Raises SourceError with file, line and cause."""
    rows: dict[int, list[_Row]] = {}
    columns, found = read_table(table)
    key = next((k for k in ("cam_id", "port") if k in columns), None)
    if key is None or "frame_time" not in columns:
        raise SourceError(f"{table} has the columns {', '.join(columns) or '(none)'}; it needs cam_id and frame_time")
    for line, row in found:
        try:
            sync = row.get("sync_index")
            at = _Row(whole(sync) if sync else None, float(row["frame_time"]))
            camera = whole(row[key])
        except (TypeError, ValueError, AttributeError) as e:
            raise SourceError(f"{table} line {line}: {e}") from e
        check_time(f"{table} line {line}", at.time)
        rows.setdefault(camera, []).append(at)
    return {camera: sorted(found, key=lambda r: r.time) for camera, found in rows.items()}


def _by_index(rows: Mapping[int, Sequence[_Row]], table: Path) -> dict[int, list[int]]:
    """{camera: sync index of each frame}. Raises SourceError where one comes twice or time and index disagree."""
    out = {camera: [int(r.sync or 0) for r in found] for camera, found in rows.items()}
    for camera, found in out.items():
        wrong = next((n for n in range(1, len(found)) if found[n] <= found[n - 1]), None)
        if wrong is not None:
            raise SourceError(
                f"{table}: camera {camera} has sync_index {found[wrong]} after {found[wrong - 1]} in order of"
                " frame_time; each must come once and ascend"
            )
    return out


def _by_time(rows: Mapping[int, Sequence[_Row]]) -> dict[int, list[int]]:
    """{camera: frame of the camera with most frames that is nearest in time to each frame, -1 for none}.

    None is nearer than half a period, or another frame of the camera is nearer to the same one.
    """
    times = {camera: np.array([r.time for r in found]) for camera, found in rows.items()}
    clock = max(times.values(), key=len)
    half = float(np.median(np.diff(clock))) / 2 if len(clock) > 1 else np.inf
    out: dict[int, list[int]] = {}
    for camera, own in times.items():
        nearest = _nearest(own, clock)
        mutual = _nearest(clock, own)[nearest] == np.arange(len(own))
        out[camera] = np.where(mutual & (np.abs(own - clock[nearest]) <= half), nearest, -1).tolist()
    return out


def _nearest(times: np.ndarray, among: np.ndarray) -> np.ndarray:
    """[n] index of the nearest of `among` [m], ascending, to each of `times` [n]; the earlier of two."""
    if len(among) == 1:
        return np.zeros(len(times), dtype=np.int64)
    after = np.searchsorted(among, times).clip(1, len(among) - 1)
    before = after - 1
    return np.where(times - among[before] <= among[after] - times, before, after)


def _described(groups: Mapping[int, Sequence[int]], rows: Mapping[int, Sequence[_Row]], how: str) -> Instants:
    """Groups numbered from 0, the rate of their mean times, and how far apart the frames of a group are."""
    known = sorted({g for found in groups.values() for g in found if g >= 0})
    number = {g: n for n, g in enumerate(known)}
    frames = {c: {number[g]: at for at, g in enumerate(found) if g >= 0} for c, found in groups.items()}
    members: list[list[float]] = [[] for _ in known]
    for camera, placed in frames.items():
        for n, at in placed.items():
            members[n].append(rows[camera][at].time)
    apart = max((max(m) - min(m) for m in members), default=0.0)
    gaps = np.diff([float(np.mean(m)) for m in members])
    rate = 1 / float(np.mean(gaps)) if len(gaps) and np.mean(gaps) > 0 else 0.0
    left = {c: sum(g < 0 for g in found) for c, found in groups.items()}
    return Instants(
        frames,
        {c: [r.time for r in found] for c, found in rows.items()},
        rate,
        [
            f"{how}; frames of one instant are up to {1000 * apart:.1f} ms apart",
            *(f"camera {c}: {n} frames lie between two instants and are left out" for c, n in left.items() if n),
        ],
    )
