"""One PNG that shows a run at a glance: source pictures, masks, joints, depth, and the novel views made from them."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from posegaussian.storage.model.cameras import points_to_integer_centres
from posegaussian.storage.model.joint_sets import JOINT_SETS

SOURCE, NOVEL, COMPARED = 128, 512, 352
"""Heights of pictures on the sheet, px: of source views and what was made of them (four sets of square ones fit a
line), of novel views, and of novel views beside the truth (two sets fit a line)."""

MARGIN = 0.02
"""Black that stays around what is seen in a novel view, as a share of the picture's longer side."""

LABEL = 18
"""Height of a caption, px."""

WIDTH = 2240
"""Width at which a line is broken, px."""

BACKGROUND = 24
"""Grey level between the pictures."""


Strip = tuple[int, list[tuple[str, np.ndarray]]]
"""Height and captioned pictures, [h, w, 3] uint8, that stay side by side."""


@dataclass
class Sheet:
    """Strips of pictures, in sections that each start on a new line."""

    joint_set: str | None
    """Joint set of the joints that are added."""
    sections: list[list[Strip]] = field(default_factory=list)
    """Each: source views of one frame, or novel views of one frame."""

    def begin(self) -> None:
        """Start a section."""
        self.sections.append([])

    def add_source(
        self, caption: str, color: np.ndarray, mask: np.ndarray, joints: np.ndarray | None, depth: np.ndarray
    ) -> None:
        """One source view of one frame: [h, w, 3] uint8, [h, w] uint8,
        [J, 3] (u, v, score) px or None, [h, w] metres."""
        strip = [(caption, color), ("mask", np.repeat(mask[..., None], 3, axis=-1))]
        if joints is not None and self.joint_set is not None:
            strip.append(("joints", draw_joints(color, joints, self.joint_set)))
        self.sections[-1].append((SOURCE, [*strip, (_depth_caption(depth), color_depth(depth))]))

    def add_novel(self, caption: str, color: np.ndarray, truth: np.ndarray | None) -> None:
        """One rendered picture; beside it, where there is one, the held-out picture and four times the difference.

        The black around what is seen in them is cut off.
        """
        box = _seen(color if truth is None else np.maximum(color, truth))
        color, truth = color[box], None if truth is None else truth[box]
        strip = [(f"novel: {caption}", color)]
        if truth is not None:
            difference = np.abs(color.astype(np.int16) - truth).astype(np.uint16) * 4
            strip += [("held out", truth), ("difference x4", difference.clip(0, 255).astype(np.uint8))]
        self.sections[-1].append((NOVEL if truth is None else COMPARED, strip))


def _seen(picture: np.ndarray) -> tuple[slice, slice]:
    """The box of a picture [h, w, 3] that is not black, with a margin of MARGIN; the whole of a black one."""
    rows, columns = (np.flatnonzero(picture.any(axis=axes)) for axes in ((1, 2), (0, 2)))
    if not len(rows):
        return slice(None), slice(None)
    margin = round(MARGIN * max(picture.shape[:2]))
    top, left = max(0, int(rows[0]) - margin), max(0, int(columns[0]) - margin)
    return slice(top, int(rows[-1]) + 1 + margin), slice(left, int(columns[-1]) + 1 + margin)


def _depth_caption(depth: np.ndarray) -> str:
    known = depth[depth > 0]
    return f"depth {known.min():.2f}..{known.max():.2f} m" if known.size else "depth: none"


def color_depth(depth: np.ndarray) -> np.ndarray:
    """[h, w] metres -> [h, w, 3] uint8: near is red, far is blue, unknown black;
    stretched to the 2nd..98th percentile."""
    import cv2

    known = depth > 0
    if not known.any():
        return np.zeros((*depth.shape, 3), np.uint8)
    low, high = np.percentile(depth[known], [2, 98])
    level = np.clip((high - depth) / max(high - low, 1e-6), 0, 1)
    colored = cv2.applyColorMap((level * 255).astype(np.uint8), cv2.COLORMAP_TURBO)[..., ::-1]
    return np.where(known[..., None], colored, 0).astype(np.uint8)


def draw_joints(color: np.ndarray, joints: np.ndarray, joint_set: str) -> np.ndarray:
    """The picture, dimmed, with limbs of joints whose score is positive:
    right side red, left side green, middle yellow."""
    import cv2

    out = np.ascontiguousarray(color // 2)
    names = JOINT_SETS[joint_set].names
    points = points_to_integer_centres(joints[:, :2])
    known = (joints[:, 2] > 0) & np.isfinite(points).all(axis=1)
    width = max(1, round(color.shape[0] / 200))
    for a, b in JOINT_SETS[joint_set].limbs:
        if known[a] and known[b]:
            cv2.line(out, _pixel(points[a]), _pixel(points[b]), _side(names[a], names[b]), width, cv2.LINE_AA)
    for j in np.flatnonzero(known):
        cv2.circle(out, _pixel(points[j]), width + 1, (255, 255, 255), -1, cv2.LINE_AA)
    return out


def _pixel(point: np.ndarray) -> tuple[int, int]:
    limit = 2**14
    return int(np.clip(round(point[0]), -limit, limit)), int(np.clip(round(point[1]), -limit, limit))


def _side(a: str, b: str) -> tuple[int, int, int]:
    """Colour of a limb: its side's where both ends are of one side, else that of the middle."""
    sides = {n[0] if n[0] in "LR" and n[1].isupper() else "" for n in (a, b)}
    return {"R": (255, 80, 80), "L": (80, 255, 80)}.get(sides.pop() if len(sides) == 1 else "", (255, 220, 60))


def _cell(caption: str, picture: np.ndarray, height: int) -> np.ndarray:
    """One captioned picture of a height, px."""
    import cv2

    width = max(1, round(picture.shape[1] * height / picture.shape[0]))
    shrink = picture.shape[0] > height
    scaled = cv2.resize(
        np.ascontiguousarray(picture), (width, height), interpolation=cv2.INTER_AREA if shrink else cv2.INTER_NEAREST
    )
    out = np.full((height + LABEL, max(width, 7 * len(caption) + 6), 3), BACKGROUND, np.uint8)
    out[LABEL:, :width] = scaled
    cv2.putText(out, caption, (3, LABEL - 5), cv2.FONT_HERSHEY_SIMPLEX, 0.4, (230, 230, 230), 1, cv2.LINE_AA)
    return out


def write_sheet(path: Path, sheet: Sheet) -> None:
    """Write the sheet as PNG."""
    from posegaussian.storage.readers.images import write_png

    write_png(path, drawn(sheet))


def drawn(sheet: Sheet) -> np.ndarray:
    """[h, w, 3] uint8 picture of a sheet: strips fill lines of WIDTH px, every section starts on a new line."""
    lines: list[list[np.ndarray]] = []
    for section in sheet.sections:
        lines.append([])
        for height, strip in section:
            cells = np.concatenate(
                [c for caption, p in strip for c in (_cell(caption, p, height), _gap(height, 6))], axis=1
            )
            if lines[-1] and sum(s.shape[1] for s in lines[-1]) + cells.shape[1] > WIDTH:
                lines.append([])
            lines[-1] += [cells, _gap(height, 14)]
    drawn_lines = [np.concatenate(line, axis=1) for line in lines if line]
    width = max(line.shape[1] for line in drawn_lines)
    return np.concatenate(
        [np.pad(line, ((0, 8), (0, width - line.shape[1]), (0, 0)), constant_values=BACKGROUND) for line in drawn_lines]
    )


def _gap(height: int, width: int) -> np.ndarray:
    return np.full((height + LABEL, width, 3), BACKGROUND, np.uint8)
