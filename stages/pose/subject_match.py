"""Which of the people that an estimator found is the subject: by joints that came with the capture, and where no joints
tell by who is segmented on the subject's joints in space.
Whoever stands before the subject is segmented there, too, and larger.

Of somebody whom a picture cuts off, or whose face it does not show, an estimator often puts the joints wrong and still
segments them well.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from posegaussian.stages.contract.facts import TRACKED
from posegaussian.stages.contract.io import Inputs
from posegaussian.stages.geometry.points import NEAR, project
from posegaussian.stages.imaging.camera_mapping import captured_positions, switched
from posegaussian.stages.imaging.regions import to_own
from posegaussian.stages.pose.facts import HIDDEN
from posegaussian.stages.pose.subject_detections import DETECTIONS, in_frames
from posegaussian.storage.model.joint_sets import BLAZEPOSE33, joint_set, to_set
from posegaussian.storage.model.masks import foreground

FEWEST = 5
"""Joints that both must have before they are compared."""
SAME = 0.12
"""Median distance of two detectors' joints, as a share of the body's extent, up to which they are one person: they
put hips and shoulders 2 % apart, and a person beside the subject is a quarter of a body away."""
PICTURED = 8
"""Joints in space that a picture must hold before a segmentation is compared with them."""
HOLDS = 0.4
"""Share of these joints that a segmentation must hold. Of a man at a desk, cut off by two of four webcams, a board
before half of his joints, his own hold 0.4 to 1; of two simulated people those of the other one hold 0 to 0.36, but
where one stands before the other."""
NEARER = 1.2
"""Extent of somebody's joints over that of the subject's in the picture beyond which they stand nearer the camera: of
passers-by who hid a simulated person it was 1.21 to 1.74; of the man at the desk, whose joints are often wrong, at most
1.16."""
BEYOND = 1.35
"""Extent of a segmentation over that of the subject's joints beyond which it is somebody larger: a person's own is 1.0
to 1.25 times as large as their joints, those of the passers-by were 1.46 to 1.98 times."""
FLIPS = np.array(joint_set("coco17").flips)


def found_subject(inputs: Inputs, joints: np.ndarray, set_id: str) -> np.ndarray:
    """[F, V] index among the people of detection/* of the subject; -1 where the estimator did not find the subject.

    joints [F, V, J, 3] (u, v, score) px of frames/*, of joint set `set_id`: the subject in every view of the partition.
    """
    out = np.full(joints.shape[:2], -1)
    first = inputs.partition.start - inputs.span(DETECTIONS).start
    for v in inputs.views.sources:
        found = np.asarray(inputs.read(DETECTIONS, v))[first : first + len(joints)]
        for f in range(len(joints)):
            people = to_set(in_frames(inputs, v, found[f]), BLAZEPOSE33.id, "coco17")
            out[f, v] = nearest(people, to_set(joints[f, v], set_id, "coco17"))
    return out


def nearest(people: np.ndarray, subject: np.ndarray) -> int:
    """Index of the person [P, 17, 3] that lies on the subject [17, 3], px; -1 where none does. Left and right do not
    count: an estimator mirrors whom it sees from behind."""
    known = subject[:, 2] > 0
    if known.sum() < FEWEST:
        return -1
    extent = float(np.linalg.norm(np.ptp(subject[known, :2], axis=0)))
    off = [min(_apart(p, subject), _apart(p[FLIPS], subject)) for p in people]
    best = int(np.argmin(off)) if off else -1
    return best if best >= 0 and off[best] <= SAME * extent else -1


def _apart(person: np.ndarray, subject: np.ndarray) -> float:
    """Median distance, px, of the joints [17, 3] that both have; infinite where they are too few."""
    both = (person[:, 2] > 0) & (subject[:, 2] > 0)
    return float(np.median(np.linalg.norm((person - subject)[both, :2], axis=1))) if both.sum() >= FEWEST else np.inf


def nobody_else(inputs: Inputs, chosen: np.ndarray) -> np.ndarray:
    """[F] bool: frames in which nobody is followed but the subject, who is `chosen` [F, V] of the people found."""
    others = np.zeros(len(chosen), bool)
    if TRACKED in inputs.facts:
        first = inputs.partition.start - inputs.span("people/number").start
        for v in inputs.views.sources:
            numbers = np.asarray(inputs.read("people/number", v))[first : first + len(chosen)]
            subject = chosen[:, v : v + 1] == np.arange(numbers.shape[1])
            others |= ((numbers >= 0) & ~subject).any(axis=1)
    return ~others


def hidden_subject(inputs: Inputs, chosen: np.ndarray, joints3d: np.ndarray, set_id: str) -> np.ndarray:
    """[F, V] bool: pictures in which nobody found is the subject by their joints, `chosen` [F, V], and somebody who
    stands nearer is segmented on the subject's joints in space [F, J, 4], of joint set `set_id`."""
    out = np.zeros(chosen.shape, bool)
    first = inputs.partition.start - inputs.span(DETECTIONS).start
    for v, f, captured, regions in _missed(inputs, chosen, joints3d, np.ones(len(chosen), bool)):
        found = np.asarray(inputs.read(DETECTIONS, v))[first + f]
        people = to_set(in_frames(inputs, v, found), BLAZEPOSE33.id, "coco17")
        subject = to_set(_pictured(inputs, v, joints3d[f]), set_id, "coco17")
        out[f, v] = any(
            _share(*r, captured) >= HOLDS and _reach(*r, captured) > BEYOND and _nearer(p, subject)
            for p, r in zip(people, regions, strict=True)
        )
    return out


def held_subject(inputs: Inputs, chosen: np.ndarray, joints3d: np.ndarray, alone: np.ndarray) -> np.ndarray:
    """`chosen` [F, V], which of the people of detection/* is the subject, with whoever is segmented on the subject's
    joints in space [F, J, 4] in place of -1. It stays where nobody is, and in frames in which the subject is not
    `alone` [F]: somebody else may stand before the subject."""
    out = chosen.copy()
    for v, f, captured, regions in _missed(inputs, chosen, joints3d, alone):
        held = [_share(*r, captured) for r in regions]
        best = int(np.argmax(held))
        out[f, v] = best if held[best] >= HOLDS else -1
    return out


def hidden_told(chosen: np.ndarray, view: int, inputs: Inputs) -> tuple[str, ...]:
    """A sentence on the frames in which the subject is hidden from one view, of `chosen` [F, V]; none where it is in
    none."""
    frames = ", ".join(str(inputs.source_frames[f]) for f in np.flatnonzero(chosen[:, view] == HIDDEN))
    told = (
        f"somebody who stands nearer hides the subject in frames {frames}; nothing of this camera is used there: keep"
        " others out of the way, or leave it out (views.sources)"
    )
    return (told,) if frames else ()


def _missed(
    inputs: Inputs, chosen: np.ndarray, joints3d: np.ndarray, asked: np.ndarray
) -> Iterator[tuple[int, int, np.ndarray, list[tuple[np.ndarray, np.ndarray]]]]:
    """View, frame, captured positions [N, 2] px of the subject's joints in space [F, J, 4] and everybody's segmentation
    with its region, of the pictures of frames `asked` [F] bool that show enough of these joints and in which nobody is
    the subject yet by `chosen` [F, V]."""
    source_rig, crops = switched(inputs.source_rig, inputs.captured_to_calibrated, inputs.facts)
    for v in inputs.views.sources:
        missed = np.flatnonzero((chosen[:, v] == -1) & asked)
        if not len(missed):
            continue
        people, regions = inputs.read("detection/person", v), inputs.read("detection/region", v)
        for f in missed:
            joints = _pictured(inputs, v, joints3d[f])
            pixels = joints[joints[:, 2] > 0, :2]
            if len(pixels) >= PICTURED:
                captured = captured_positions(
                    pixels, inputs.rig.intrinsics[v], source_rig.intrinsics[v], source_rig.distortion[v], crops[v]
                )
                yield v, int(f), captured, list(zip(people[f], regions[f], strict=True))


def _nearer(person: np.ndarray, subject: np.ndarray) -> bool:
    """Whether a person [17, 3] px spans that much more of the picture than the subject [17, 3], by the joints that both
    have; not where these are few."""
    both = (person[:, 2] > 0) & (subject[:, 2] > 0)
    own, other = (float(np.linalg.norm(np.ptp(j[both, :2], axis=0))) if both.any() else 0.0 for j in (person, subject))
    return bool(both.sum() >= PICTURED and own > NEARER * other)


def _pictured(inputs: Inputs, view: int, joints: np.ndarray) -> np.ndarray:
    """[J, 3] (u, v, score) px of frames/* of joints in space [J, 4]; score 0 where one does not lie in the view's
    picture."""
    pixels, depth = (a[:, 0] for a in project(inputs.rig.subset([view]), joints[:, :3]))
    inside = ((pixels >= 0) & (pixels < inputs.rig.size[view])).all(axis=-1) & (depth > NEAR)
    return np.concatenate([pixels, (joints[:, 3] * inside)[:, None]], axis=-1)


def _share(person: np.ndarray, region: np.ndarray, captured: np.ndarray) -> float:
    """Share of the captured positions [N, 2] px that a segmentation [n, n] uint8 over its region [4] holds."""
    if region[2] <= 0:
        return 0.0
    cells = np.floor(to_own(captured, region) * len(person))
    there = np.isfinite(cells).all(axis=-1) & ((cells >= 0) & (cells < len(person))).all(axis=-1)
    columns, rows = cells[there].astype(np.int64).T
    return float(foreground(person[rows, columns]).sum() / len(captured))


def _reach(person: np.ndarray, region: np.ndarray, captured: np.ndarray) -> float:
    """Extent of a segmentation [n, n] uint8 over its region [4], over that of captured positions [N, 2] px."""
    rows, columns = np.nonzero(foreground(person))
    own = to_own(captured[np.isfinite(captured).all(axis=-1)], region) * len(person)
    if not len(rows) or not len(own):
        return 0.0
    return float(np.hypot(np.ptp(rows), np.ptp(columns)) / max(np.linalg.norm(np.ptp(own, axis=0)), 1.0))
