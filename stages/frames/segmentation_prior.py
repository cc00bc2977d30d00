"""What is known of the subject before a pixel is looked at: the estimator's segmentation, the joints, and what
the other views saw."""

from __future__ import annotations

import cv2
import numpy as np

from posegaussian.stages.contract.facts import SEGMENTED, TRACKED
from posegaussian.stages.contract.io import Inputs
from posegaussian.stages.frames.bodies.other_people import Others, Strangers, others_in, strangers_in
from posegaussian.stages.frames.bodies.own_joints import pixels_per_metre_at
from posegaussian.stages.frames.person_matte import FAINT, Known
from posegaussian.stages.geometry.projection import pixel_centres, rays
from posegaussian.stages.geometry.subject import look_at_point
from posegaussian.stages.imaging.camera_mapping import captured_positions, switched
from posegaussian.stages.imaging.regions import to_own
from posegaussian.stages.pose.facts import HIDDEN
from posegaussian.stages.silhouettes.support import Fields, ray_support
from posegaussian.storage.model.cameras import (
    Rig,
    points_from_integer_centres,
    points_to_integer_centres,
    to_integer_centres,
)

CELL = 4
"""Pixels of frames/* along a cell of the grids on which views are compared."""
AROUND = 0.5
"""Metres from the nearest and the farthest joint within which the subject lies along a ray."""
STEP = 1.5
"""Cells by which a point of a ray moves in another view, at most, from one depth to the next."""


def warped_hint(person: np.ndarray, region: np.ndarray, captured: np.ndarray) -> np.ndarray:
    """[h, w] float32 0..1 segmentation of one person at captured positions [h, w, 2] px, NaN where the lens has no
    picture; negative there and where the region does not reach.

    person [n, n] uint8 over region [4]: the centre of its cell (i, j) lies at ((j + .5)/n, (i + .5)/n) of the region.
    Where the positions lie more than two cells apart cells are averaged first, so that nothing aliases.
    """
    shape, side = captured.shape[:2], person.shape[0]
    own = to_own(captured.reshape(-1, 2), region)
    inside = np.all((own >= 0) & (own <= 1), axis=-1).reshape(shape)
    shrink = int(np.clip(_spacing(captured) / region[2] * side, 1, side // 8))
    small = person if shrink < 2 else cv2.resize(person, (side // shrink,) * 2, interpolation=cv2.INTER_AREA)
    at = (
        points_to_integer_centres(np.where(inside.reshape(-1, 1), own, -1.0) * small.shape[0])
        .astype(np.float32)
        .reshape(*shape, 2)
    )
    # OpenCV's stubs do not know that the second map may be None
    values = cv2.remap(small, at, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)  # type: ignore[call-overload]
    return np.where(inside, values.astype(np.float32) / np.float32(255), np.float32(-1.0))


def _spacing(captured: np.ndarray) -> float:
    """Captured px from one position of [h, w, 2] to the next, amid those of the middle row that the lens has a picture
    of; 0 where these are fewer than two. Corners, which a lens bends most, may have none (NaN)."""
    row = captured[len(captured) // 2]
    seen = row[np.isfinite(row).all(axis=-1)]
    middle = seen[max(len(seen) - 1, 0) // 2 :][:2]
    return float(np.linalg.norm(middle[1] - middle[0])) if len(middle) == 2 else 0.0


class Hints:
    """The subject in the frames of one task, by view."""

    def __init__(self, inputs: Inputs, margin: float) -> None:
        """margin: by how much a view's segmentation may be off, share of the side of its region."""
        self._inputs, self._margin = inputs, margin
        sources = inputs.views.sources if SEGMENTED in inputs.facts else ()
        self._person = {v: inputs.read("detection/person", v) for v in sources}
        self._region = {v: inputs.read("detection/region", v) for v in sources}
        self._chosen = {v: inputs.read("pose/chosen", v) for v in sources}
        self._alone = inputs.read("pose/alone") if SEGMENTED in inputs.facts else None
        self._joints3d = inputs.read("pose/joints3d")
        self._others3d = inputs.read("pose/others3d") if TRACKED in inputs.facts else None
        self._joints2d = {inputs.view: inputs.read("pose/joints2d", inputs.view)}
        self._captured: dict[tuple[int, int], np.ndarray] = {}

    def known(self, view: int, frame: int) -> Known:
        """What is known of the subject in one picture of a view."""
        joints, in_space = np.array(self._joints2d[view][frame], dtype=np.float64), self._joints3d[frame, :, 3] > 0
        if in_space.any():
            joints[~in_space, 2] = 0.0
        possible, confirmed = self.support(view, frame) or (None, None)
        rig, joint_set = self._inputs.rig, self._inputs.joint_set
        assert joint_set is not None, "the person matte needs joints"
        alone = self._alone is not None and bool(self._alone[frame, 0])
        hint, others = self.of_view(view, frame), self.others(view, frame)
        scale = pixels_per_metre_at(rig, view, np.asarray(self._joints3d[frame], dtype=np.float64), joint_set)
        return Known(hint, joints, joint_set, possible, confirmed, alone, others, scale)

    def hidden(self, view: int, frame: int) -> bool:
        """Whether somebody else hides the subject from a view."""
        return view in self._chosen and int(self._chosen[view][frame]) == HIDDEN

    def others(self, view: int, frame: int, cell: int = 1) -> Others | None:
        """Where somebody else is in a picture of a view, on its grid of `cell` px; None where nobody is known to be."""
        if self._others3d is None:
            return None
        rig, set_id = self._inputs.rig, self._inputs.joint_set
        assert set_id is not None, "people are followed by their joints"
        width, height = (-(-int(n) // cell) for n in rig.size[view])
        subject, others = (np.asarray(a[frame], dtype=np.float64) for a in (self._joints3d, self._others3d))
        return others_in(rig, view, subject, others, set_id, (width, height), cell)

    def strangers(self, view: int, frame: int) -> Strangers | None:
        """Where everybody else is in a picture of a view, in a frame in which nobody knows where the subject is."""
        if self._others3d is None:
            return None
        rig, set_id = self._inputs.rig, self._inputs.joint_set
        assert set_id is not None, "people are followed by their joints"
        subject, others = (np.asarray(a[frame], dtype=np.float64) for a in (self._joints3d, self._others3d))
        return strangers_in(rig, view, subject, others, set_id, (int(rig.size[view, 0]), int(rig.size[view, 1])))

    def of_view(self, view: int, frame: int, cell: int = 1) -> np.ndarray | None:
        """[h, w] float32 segmentation on a view's grid of `cell` px; negative where the estimator did not look, None
        where it found nobody."""
        if view not in self._chosen or (person := int(self._chosen[view][frame])) < 0:
            return None
        found, region = self._person[view][frame, person], self._region[view][frame, person]
        return warped_hint(found, region, self._positions(view, cell)) if region[2] > 0 and found.any() else None

    def support(self, view: int, frame: int) -> tuple[np.ndarray, np.ndarray] | None:
        """Possible and confirmed [h, w] float32 0..1 of a view's pixels by what all other views saw; None where none
        saw the subject.

        See `support.ray_support`. Where its estimator did not look, and where somebody else stands before the subject,
        a view says nothing; where they stand beside it the subject is not. Rays are walked as deep as the known joints
        lie, give or take half a metre.
        """
        inputs = self._inputs
        grids = {u: self.of_view(u, frame, CELL) for u in inputs.views.sources if u != view}
        seen = {u: g for u, g in grids.items() if g is not None}
        if not seen:
            return None
        fields = _fields(
            inputs.rig,
            seen,
            {u: self._radius(u, frame) for u in seen},
            {u: self.others(u, frame, CELL) for u in seen},
        )
        width, height = (-(-int(n) // CELL) for n in inputs.rig.size[view])
        pixels = pixel_centres((width, height)).reshape(-1, 2) * CELL
        origin, directions = rays(pixels, inputs.rig.intrinsics[view], inputs.rig.world_to_camera[view])
        joints = self._joints3d[frame]
        found = ray_support(
            fields, origin, directions, self._depths(view, frame, sorted(seen)), joints[joints[:, 3] > 0, :3]
        )
        whole = (int(inputs.rig.size[view, 0]), int(inputs.rig.size[view, 1]))
        return tuple(_enlarged(f.reshape(height, width), whole) for f in found)  # type: ignore[return-value]

    def _positions(self, view: int, cell: int) -> np.ndarray:
        """[h, w, 2] captured px of the centres of a view's cells; NaN where the lens has no picture."""
        if (view, cell) not in self._captured:
            inputs = self._inputs
            source_rig, crops = switched(inputs.source_rig, inputs.captured_to_calibrated, inputs.facts)
            size = -(-inputs.rig.size[view] // cell)
            pixels = pixel_centres((int(size[0]), int(size[1]))) * cell
            self._captured[view, cell] = captured_positions(
                pixels,
                inputs.rig.intrinsics[view],
                source_rig.intrinsics[view],
                source_rig.distortion[view],
                crops[view],
            )
        return self._captured[view, cell]

    def _radius(self, view: int, frame: int) -> int:
        """Cells by which a view's segmentation may be off."""
        side = float(self._region[view][frame, int(self._chosen[view][frame]), 2])
        spacing = _spacing(self._positions(view, CELL))
        return int(np.ceil(self._margin * side / spacing)) if spacing > 0 else 0

    def _depths(self, view: int, frame: int, others: list[int]) -> np.ndarray:
        """[K] depths along a view's rays at which the others are asked, metres: around the joints, else around what
        all cameras look at."""
        rig, joints = self._inputs.rig, self._joints3d[frame]
        points = np.asarray(joints[joints[:, 3] > 0, :3], dtype=np.float64)
        around = AROUND
        if not len(points):
            points = look_at_point(rig)[None]
            around = 0.5 * float(np.linalg.norm(rig.centres - points, axis=1).min())
        z = points @ rig.rotations[view, 2] + rig.world_to_camera[view, 2, 3]
        near, far = max(float(z.min()) - around, 0.05), float(z.max()) + around
        if far <= near:
            return np.zeros(0)
        nearest = max(float((np.linalg.norm(rig.centres[others][:, None] - points, axis=2)).min()) - around, 0.2)
        metres = STEP * CELL * nearest / float(rig.intrinsics[others][:, [0, 1], [0, 1]].max())
        return np.linspace(near, far, int(np.clip((far - near) / metres, 8, 512)))


def _fields(rig: Rig, grids: dict[int, np.ndarray], radius: dict[int, int], others: dict[int, Others | None]) -> Fields:
    """What the views' segmentations on coarse grids hold possible, widened by a radius in cells, and what they saw."""
    views = sorted(grids)
    height, width = (max(grids[v].shape[i] for v in views) for i in (0, 1))
    possible, seen = (
        np.ones((len(views), height, width), np.float32),
        np.full((len(views), height, width), -1.0, np.float32),
    )
    for i, v in enumerate(views):
        saw = grids[v]
        if (other := others[v]) is not None:
            saw = np.where(other.before, np.float32(-1), np.where(other.beside, np.float32(0), saw))
        may = np.abs(saw)  # -1, a view that does not look or see past, leaves everything possible
        disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius[v] + 1,) * 2)
        possible[i, : saw.shape[0], : saw.shape[1]] = cv2.dilate(np.clip(may / np.float32(2 * FAINT), 0, 1), disc)
        seen[i, : saw.shape[0], : saw.shape[1]] = saw
    coarse = rig.intrinsics[views].copy()
    coarse[:, :2] /= CELL
    return Fields(possible, seen, to_integer_centres(coarse) @ rig.world_to_camera[views, :3])


def _enlarged(grid: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """A grid of cells [h, w] at the pixels it covers, bilinear, cut to `size` (width, height)."""
    columns, rows = (
        points_to_integer_centres(points_from_integer_centres(np.arange(n)) / CELL).astype(np.float32) for n in size
    )
    x, y = np.meshgrid(columns, rows)
    return cv2.remap(grid, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
