"""Where a camera path leaves what source cameras show together: the gaps it crosses, for the warnings of a plan."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence

import numpy as np

from posegaussian.stages.camera_paths.stretch import side_by_side
from posegaussian.stages.geometry.pairs import SHOWN, PairReport, PairVerdict, pair_report
from posegaussian.stages.geometry.subject import look_at_point
from posegaussian.storage.model.cameras import CameraPath, Rig

Gap = tuple[int, ...]
"""Who stands on either side of a gap: two source cameras, or the one beyond which nobody stands."""
BESIDE = 10.0
"""Degrees at the subject up to which a picture is a source camera's own, whoever else stands there: as far as the
relief of a single camera is worth looking at."""
SLACK = 3.0
"""Degrees by which a picture may leave the space between two cameras: paths smooth uneven heights."""
LOOKED_AT = 360
"""Pictures of a path that are looked at, at most, spread evenly."""
NAMED = 3
"""Gaps of a path that a sentence names."""
STANDING = ("held_out", "still")
"""Kinds of paths that stand where a camera of the capture stands: whoever asks for them knows where that is."""


def gap_notes(rig: Rig, sources: Sequence[int], max_angle: float, paths: Mapping[str, CameraPath]) -> list[str]:
    """Sentences for the plan on paths that go where no two source cameras that depth can match, and that stand within
    `SHOWN` degrees, lie on either side.

    `rig` holds the cameras of the frames grid, `max_angle` is in degrees. A single source camera has no sides: what it
    shows is told by `cone_notes`.
    """
    if len(sources) < 2:
        return []
    rig = rig.subset(sources)
    bound = min(max_angle, SHOWN)
    reports = {r.views: r for r in pair_report(rig, None, bound)}
    found = []
    for path in paths.values():
        gaps, share = ([], 0.0) if path.kind in STANDING else _crossed(rig, reports, _directions(rig, path))
        if gaps:
            told = [_told(rig, reports, gap) for gap in gaps[:NAMED]]
            more = f" and {len(gaps) - NAMED} more" if len(gaps) > NAMED else ""
            found.append(
                f"camera path {path.text!r}: {share:.0%} of its pictures lie where no two neighbours that can be"
                f" matched stand within {bound:g} degrees at the subject: {', '.join(told)}{more}; expect torn limbs"
                f" and holes there. {_instead(rig, reports, gaps[:NAMED])}"
            )
    return found


def _directions(rig: Rig, path: CameraPath) -> np.ndarray:
    """[N, 3] unit vectors from the subject to where pictures of a path are taken from."""
    poses = path.world_to_camera[path.served]
    poses = poses[np.unique(np.linspace(0, len(poses) - 1, min(len(poses), LOOKED_AT)).round().astype(int))]
    return _unit(-np.einsum("nji,nj->ni", poses[:, :3, :3], poses[:, :3, 3]) - look_at_point(rig))


def _unit(vectors: np.ndarray) -> np.ndarray:
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12))


def _degrees(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """[A, B] degrees between unit vectors."""
    return np.asarray(np.degrees(np.arccos(np.clip(a @ b.T, -1.0, 1.0))))


def _crossed(rig: Rig, reports: Mapping[tuple[int, int], PairReport], pictures: np.ndarray) -> tuple[list[Gap], float]:
    """The gaps in which pictures [N, 3] lie between no pair `side_by_side`, each once, and the share of those pictures.

    A picture lies between two cameras that are both nearer to it than they are to each other.
    """
    views = sorted({v for pair in reports for v in pair})
    off = dict(zip(views, _degrees(_unit(rig.centres[views] - look_at_point(rig)), pictures), strict=True))
    pairs = sorted(reports.values(), key=lambda r: r.angle)
    between = np.array([np.maximum(*(off[v] for v in r.views)) <= r.angle + SLACK for r in pairs])
    matched = np.array([side_by_side(r) for r in pairs])
    outside = (np.min(list(off.values()), axis=0) > BESIDE) & ~between[matched].any(axis=0)
    gaps: dict[Gap, None] = {}
    for n in np.flatnonzero(outside):
        alone = (min(views, key=lambda v: off[v][n]),)
        gaps[pairs[int(np.argmax(between[:, n]))].views if between[:, n].any() else alone] = None
    return list(gaps), float(outside.mean()) if len(outside) else 0.0


def _told(rig: Rig, reports: Mapping[tuple[int, int], PairReport], gap: Gap) -> str:
    """A gap, with its angle or what else keeps its cameras from being matched."""
    names = " and ".join(rig.names[v] for v in gap)
    if len(gap) == 1:
        return f"beyond {names} (no camera there)"
    report = reports[gap[0], gap[1]]
    wide = report.verdict is PairVerdict.TOO_WIDE
    return f"between {names} ({f'{report.angle:.0f} degrees' if wide else report.sentence.partition(': ')[2]})"


def _instead(rig: Rig, reports: Mapping[tuple[int, int], PairReport], gaps: Sequence[Gap]) -> str:
    """What to render in place of a path across gaps: the cameras at their ends, each with the nearest that it can be
    matched with."""
    matched = sorted((r for r in reports.values() if side_by_side(r)), key=lambda r: r.angle)
    if not matched:
        return (
            "No two that can be matched stand that near: --path sway stays near one, and a camera in the gap would"
            " close it"
        )
    partners = [next((r.views for r in matched if v in r.views), None) for gap in gaps for v in gap]
    named = [(shlex.quote(rig.names[p[0]]), shlex.quote(rig.names[p[1]])) for p in partners if p is not None]
    arcs = dict.fromkeys(shlex.quote(f"arc {a} {b}") for a, b in named)
    return f"No gap is crossed by --path {' or '.join(['between', *arcs])}"
