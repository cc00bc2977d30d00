"""Where somebody else is in a picture: bodies of capsules about everybody's joints in space, the nearer before the
farther."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from posegaussian.stages.frames.bodies.body import body_depth, body_shape, pixels_per_metre
from posegaussian.stages.frames.bodies.own_joints import not_too_broad, own_joints, person_depth
from posegaussian.stages.geometry.points import NEAR, project
from posegaussian.storage.model.cameras import Rig

CLEARLY = 0.05
"""Metres by which somebody must stand before the subject to hide it: joints in space err by about as much."""
WHOLE = 0.5
"""Share of how far the middle of a person stands before the other's that is added to how far a bone lies before the
other: where two people touch, their joints on that side are put as deep as each other's, their middles are not."""
WIDE = 1.25
"""Thickness of the subject's body, over that of its capsules, within which somebody behind it hides nothing of it:
clothes, hair and hands."""
CORE = 0.5
"""Share of a body's thickness that is surely within it."""


@dataclass(frozen=True, eq=False)
class Others:
    """Where somebody else is in a picture of the subject."""

    before: np.ndarray
    """[h, w] bool: before the subject."""
    beside: np.ndarray
    """[h, w] bool: where the subject is not."""
    nearer: np.ndarray
    """[h, w] bool: around neither, and nearer to somebody else."""
    hides: float
    """Share of the subject's body in the picture that is behind somebody."""

    @property
    def anywhere(self) -> np.ndarray:
        """[h, w] bool: where a pixel is somebody else's."""
        return self.before | self.beside | self.nearer


@dataclass(frozen=True, eq=False)
class Strangers:
    """Where everybody else who is followed is in a picture, of which nothing is known of the subject."""

    core: np.ndarray
    """[h, w] bool: surely theirs."""
    around: np.ndarray
    """[h, w] bool: their bodies with clothes, hair and hands."""

    def taken_out(self, found: np.ndarray) -> np.ndarray:
        """A foreground [h, w] uint8 0 or 1 without the parts of it that are theirs: those that reach into somebody's
        core, shadow and all, and those that lie around somebody for at least half. What is apart stays: it may be the
        subject, whom the detector missed."""
        count, labels = cv2.connectedComponents(found, connectivity=8)
        areas, near = (np.bincount(a.ravel(), minlength=count) for a in (labels, labels[self.around]))
        theirs = 2 * near >= areas
        theirs[np.unique(labels[self.core])] = True
        theirs[0] = False
        return np.where(theirs[labels], np.uint8(0), found)


def strangers_in(
    rig: Rig, view: int, subject: np.ndarray, others: np.ndarray, set_id: str, size: tuple[int, int]
) -> Strangers | None:
    """Where `others` [N, J, 4] (x, y, z, score) world metres are in a picture of a view, of `size` (width, height) px;
    None where the views know where the subject [J, 4] is, and where the picture shows nobody."""
    known = others[(others[..., 3] > 0).any(axis=1)]
    if not len(known) or (subject[:, 3] > 0).any():
        return None
    core, around = (np.zeros(size[::-1], bool) for _ in range(2))
    for person in known:
        joints = own_joints(person, set_id)
        pixels, depth = (a[:, 0] for a in project(rig.subset([view]), joints[:, :3]))
        seen = np.concatenate([pixels, (joints[:, 3] * (depth > NEAR))[:, None]], axis=-1)
        scale = pixels_per_metre(seen, set_id)
        core |= body_shape(seen, set_id, size, CORE * scale)
        around |= body_shape(seen, set_id, size, WIDE * scale)
    return Strangers(core, around) if around.any() else None


def others_in(
    rig: Rig, view: int, subject: np.ndarray, others: np.ndarray, set_id: str, size: tuple[int, int], cell: int = 1
) -> Others | None:
    """Where `others` [N, J, 4] (x, y, z, score) world metres are in a view, on a grid of `size` (width, height) cells
    of `cell` px; None where the view shows nothing that is known of them, or of the subject [J, 4]."""
    known = others[(others[..., 3] > 0).any(axis=1)]
    if not len(known) or not (subject[:, 3] > 0).any():
        return None

    def depth_of(joints: np.ndarray, thickness: float) -> np.ndarray:
        pixels, depth = (a[:, 0] for a in project(rig.subset([view]), joints[:, :3]))
        seen = np.concatenate([pixels / cell, (joints[:, 3] * (depth > NEAR))[:, None]], axis=-1)
        return body_depth(seen, depth, set_id, size, thickness * pixels_per_metre(seen, set_id))

    subject = own_joints(subject, set_id)
    middle, wide = person_depth(rig, view, subject), depth_of(subject, WIDE)
    farther, there = np.full(wide.shape, -np.inf), np.zeros(wide.shape, bool)
    for person in known:
        other = own_joints(not_too_broad(person, subject, set_id), set_id)
        depth = depth_of(other, 1.0)
        covered = np.isfinite(depth)
        farther[covered] = np.maximum(
            farther[covered], wide[covered] - depth[covered] + WHOLE * (middle - person_depth(rig, view, other))
        )
        there |= covered
    body, around = np.isfinite(depth_of(subject, 1.0)), np.isfinite(wide)
    if not there.any() or not body.any():
        return None
    before = around & (farther > np.where(body, CLEARLY, -CLEARLY))
    beside = there & ~around
    nearer = _distance(before | beside) < _distance(body & ~before)
    return Others(before, beside, nearer & ~around, float((before & body).sum() / body.sum()))


def _distance(shape: np.ndarray) -> np.ndarray:
    """[h, w] float32 px to the nearest pixel of a shape [h, w] bool; very far where it is empty."""
    far = np.full(shape.shape, 1e6, np.float32)
    return cv2.distanceTransform((~shape).astype(np.uint8), cv2.DIST_L2, 5) if shape.any() else far
