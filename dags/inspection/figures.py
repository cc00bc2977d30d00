"""Pictures of an inspection: each pair of cameras side by side, with epipolar lines,
joints and the outline of the hull."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from posegaussian.dags.inspection.portraits import Portrait
from posegaussian.stages.contract.facts import JOINTS2D, MASKS
from posegaussian.stages.geometry.epipolar import fundamental, homogeneous
from posegaussian.stages.geometry.points import project
from posegaussian.stages.geometry.projection import rays
from posegaussian.stages.geometry.subject import look_at_point
from posegaussian.stages.inspection.footage import Footage
from posegaussian.stages.inspection.matching import Matched
from posegaussian.stages.inspection.planned import Planned
from posegaussian.stages.inspection.report import Report
from posegaussian.stages.silhouettes.hull import Silhouettes, searched_radius
from posegaussian.stages.survey.algorithms.joints import SCORE
from posegaussian.storage.model.cameras import points_from_integer_centres, points_to_integer_centres
from posegaussian.storage.model.joint_sets import joint_set
from posegaussian.storage.model.masks import foreground
from posegaussian.storage.readers.images import write_png

HEIGHT = 720
"""Px of a pair's picture."""
THUMBNAIL = 240
"""Px of a person's picture, at most."""
LINES = 10
"""Matched points that are drawn with their lines."""
MOST = 60
"""Pair pictures, narrowest first."""
COLORS = [
    (230, 80, 60),
    (60, 160, 240),
    (90, 200, 90),
    (240, 180, 40),
    (190, 100, 220),
    (60, 210, 200),
    (240, 120, 170),
    (160, 160, 60),
    (120, 120, 250),
    (200, 200, 200),
]
SEEN, EXPECTED, OUTLINE, HULL = (255, 210, 0), (0, 230, 255), (255, 255, 255), (255, 0, 200)
"""Joints as seen, joints as the cameras together put them, a mask's outline, and what the other masks leave."""


@dataclass(frozen=True)
class PairPicture:
    """One picture of the page."""

    views: tuple[int, int]
    """Indices of the cameras."""
    file: Path
    """PNG."""
    caption: str
    """What is seen."""


def write_pictures(footage: Footage, report: Report, folder: Path) -> list[PairPicture]:
    """One PNG a pair of cameras, `CAMERA-CAMERA.png`; of a single camera its own, `CAMERA.png`."""
    panels = _Panels(footage, report.planned)
    if len(footage.rig) == 1:
        file = folder / f"{footage.names[0]}.png"
        write_png(file, _fitted(panels.panel(0)))
        return [PairPicture((0, 0), file, footage.names[0])]
    matches, out = {m.views: m for m in report.matches}, []
    for pair in sorted(sorted(report.pairs, key=lambda p: p.angle)[:MOST], key=lambda p: p.views):
        a, b = pair.views
        file = folder / f"{footage.names[a]}-{footage.names[b]}.png"
        left, right = panels.panel(a).copy(), panels.panel(b).copy()
        if pair.kind != "coincident":
            _lines(footage, (a, b), matches.get((a, b)), left, right, panels.number)
        sides = [_fitted(left), _fitted(right)]
        write_png(file, np.concatenate([sides[0], np.full((HEIGHT, 6, 3), 255, np.uint8), sides[1]], axis=1))
        out.append(
            PairPicture(
                (a, b),
                file,
                f"{footage.names[a]} and {footage.names[b]}, frame {panels.number}: {pair.fate} ({pair.kind}),"
                f" {pair.angle:.0f} degrees at the subject",
            )
        )
    return out


def write_portraits(footage: Footage, people: Sequence[Portrait], folder: Path) -> list[Path]:
    """One PNG a person, `person1.png`, as large as they are in the picture that shows them largest, at most."""
    out = []
    for p in people:
        left, top, right, bottom = p.box
        cut = footage.raw(p.view, p.number)[top : max(bottom, top + 1), left : max(right, left + 1)]
        scale = min(1.0, THUMBNAIL / cut.shape[0])
        width, height = max(1, round(cut.shape[1] * scale)), max(1, round(cut.shape[0] * scale))
        out.append(folder / f"{p.name}.png")
        write_png(out[-1], cv2.resize(cut, (width, height), interpolation=cv2.INTER_AREA))
    return out


def _fitted(picture: np.ndarray) -> np.ndarray:
    scale = HEIGHT / picture.shape[0]
    return cv2.resize(
        picture,
        (max(1, round(picture.shape[1] * scale)), HEIGHT),
        interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR,
    )


class _Panels:
    """Each camera's picture of one frame with joints and outlines, made once."""

    def __init__(self, footage: Footage, planned: Planned) -> None:
        self.footage, self.number, self._planned = footage, footage.looked_at[0], planned
        self._made: dict[int, np.ndarray] = {}
        self._masks = footage.masks(self.number) if MASKS in footage.facts else {}

    def panel(self, view: int) -> np.ndarray:
        """[h, w, 3] uint8 in px of the footage's rig."""
        if view not in self._made:
            picture = self.footage.picture(view, self.number)
            width, height = (int(n) for n in self.footage.rig.size[view])
            drawn = np.zeros((height, width, 3), np.uint8) if picture is None else picture.copy()
            self._outlines(view, drawn)
            self._joints(view, drawn)
            self._made[view] = drawn
        return self._made[view]

    def _outlines(self, view: int, drawn: np.ndarray) -> None:
        if view not in self._masks or len(self._planned.masks_against(view, self._masks)) < 2:
            return
        h, w = drawn.shape[:2]
        own = foreground(self._masks[view][:h, :w])
        hull = _hull(self.footage, self._planned.masks_against(view, self._masks), view, (w, h))
        for region, color in ((own, OUTLINE), (hull, HULL)):
            outlines, _ = cv2.findContours(region.astype(np.uint8), cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
            cv2.drawContours(drawn, outlines, -1, color, max(1, h // 500))

    def _joints(self, view: int, drawn: np.ndarray) -> None:
        footage = self.footage
        if JOINTS2D not in footage.facts or len(footage.rig) < 2:
            return
        at = footage.joint_numbers.index(self.number)
        seen, space = footage.joints[0][at, view], footage.joints[1][at]
        expected = project(footage.rig, space[:, :3])[0][:, view]
        size = max(2, drawn.shape[0] // 250)
        for a, b in joint_set("coco17").limbs:
            if space[a, 3] > 0 and space[b, 3] > 0:
                cv2.line(drawn, _pixel(expected[a]), _pixel(expected[b]), EXPECTED, max(1, size // 3), cv2.LINE_AA)
        for j in range(len(space)):
            if seen[j, 2] >= SCORE:
                cv2.circle(drawn, _pixel(seen[j, :2]), size, SEEN, -1, cv2.LINE_AA)
            if space[j, 3] > 0:
                cv2.circle(drawn, _pixel(expected[j]), size + 2, EXPECTED, max(1, size // 3), cv2.LINE_AA)
            if seen[j, 2] >= SCORE and space[j, 3] > 0:
                cv2.line(drawn, _pixel(seen[j, :2]), _pixel(expected[j]), EXPECTED, max(1, size // 3), cv2.LINE_AA)


def _hull(footage: Footage, masks: dict[int, np.ndarray], view: int, size: tuple[int, int]) -> np.ndarray:
    """[h, w] bool: where a camera's rays meet the hull of the other masks; asked on every second pixel."""
    views = sorted(masks)
    centre = look_at_point(footage.rig.subset(views))
    others = Silhouettes.of(
        footage.rig, {v: masks[v] for v in views if v != view}, centre, searched_radius(footage.rig, views, centre)
    )
    columns, rows = np.meshgrid(np.arange(0, size[0], 2), np.arange(0, size[1], 2))
    origin, directions = rays(
        points_from_integer_centres(np.stack([columns, rows], axis=-1)).reshape(-1, 2),
        footage.rig.intrinsics[view],
        footage.rig.world_to_camera[view],
    )
    inside = (others.ends(origin, directions, votes=False)[:, 0] > 0).reshape(rows.shape)
    return np.asarray(cv2.resize(inside.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0)


def _lines(
    footage: Footage, views: tuple[int, int], found: Matched | None, left: np.ndarray, right: np.ndarray, number: int
) -> None:
    """Some points of each picture, and in the other one their epipolar lines and,
    where they are matched, their partners."""
    matrix = fundamental(footage.rig, *views)
    first, second = _drawn(found, number, footage, views)
    for i, x in enumerate(first):
        color = COLORS[i % len(COLORS)]
        _mark(left, x, color)
        _line(right, matrix @ homogeneous(x), color)
        if second is not None:
            _mark(right, second[i], color)
            _line(left, matrix.T @ homogeneous(second[i]), color)


def _drawn(
    found: Matched | None, number: int, footage: Footage, views: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray | None]:
    """Matches held for right that are spread over the picture;
    without any the joints that both cameras see; else nothing."""
    if found is not None and (good := np.flatnonzero(found.fit.agree & (found.numbers == number))).size:
        spread = good[np.argsort(found.first[good, 1], kind="stable")]
        chosen = spread[np.unique(np.rint(np.linspace(0, len(spread) - 1, min(LINES, len(spread)))).astype(int))]
        return found.first[chosen], found.second[chosen]
    if JOINTS2D in footage.facts and len(footage.rig) > 1:
        seen = footage.joints[0][footage.joint_numbers.index(number)]
        both = np.flatnonzero((seen[list(views), :, 2] >= SCORE).all(axis=0))[:LINES]
        return seen[views[0], both, :2], seen[views[1], both, :2]
    return np.zeros((0, 2)), None


def _pixel(point: np.ndarray) -> tuple[int, int]:
    x, y = np.rint(np.clip(points_to_integer_centres(point), -2e4, 2e4)).astype(int)
    return int(x), int(y)


def _mark(picture: np.ndarray, point: np.ndarray, color: tuple[int, int, int]) -> None:
    size = max(3, picture.shape[0] // 160)
    cv2.circle(picture, _pixel(point), size + 1, (0, 0, 0), 2, cv2.LINE_AA)
    cv2.circle(picture, _pixel(point), size, color, 2, cv2.LINE_AA)


def _line(picture: np.ndarray, line: np.ndarray, color: tuple[int, int, int]) -> None:
    """Draw a x + b y + c = 0, in our pixel centres."""
    h, w = picture.shape[:2]
    a, b, c = line
    if abs(b) > abs(a):
        ends = [np.array([x, -(a * x + c) / b]) for x in (0.0, float(w))]
    elif abs(a) > 0:
        ends = [np.array([-(b * y + c) / a, y]) for y in (0.0, float(h))]
    else:
        return
    cv2.line(picture, _pixel(ends[0]), _pixel(ends[1]), color, max(1, h // 700), cv2.LINE_AA)
