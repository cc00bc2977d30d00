"""Foreground of one person: what is known beforehand, refined to the pixel by colours, the background plate and edges.

Log odds are added up: of the estimator's segmentation or, without one, of the joints; of the colours nearby and of the
plate; then what other views rule out is taken away.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from posegaussian.stages.frames.bodies.body import body_shape, limb_bones, pixels_per_metre
from posegaussian.stages.frames.bodies.other_people import Others
from posegaussian.stages.frames.color_likelihood import Plate
from posegaussian.stages.frames.edge_matte import (
    along_edges,
    compared_beyond,
    distance_to,
    logit,
    soft_edge,
    without_specks,
)
from posegaussian.stages.frames.ground_shadow import shadow_density
from posegaussian.stages.frames.plate_matte import UNSEEN
from posegaussian.stages.geometry.subject import STATURE
from posegaussian.stages.imaging.part import part_around
from posegaussian.storage.model.joint_sets import joint_set

HINT_FLOOR = 0.03
"""A segmentation is taken to be wrong about a pixel that often, however sure it is."""
RULED_OUT = -12.0
"""Log odds far outside all that is known of the subject, and where another view saw the background."""
FAR_INSIDE = 3.0
"""Log odds added deep inside a segmentation: clothes may match the background there."""
GIVEN_BACK = 1.5
"""Log odds along bones that all other views confirm and the view's own segmentation misses."""
SKIN = 0.025
"""Metres about which joints alone err on where the skin is."""
BONE = 0.4
"""Share of a limb's thickness that is surely within it."""
MISSED_LENGTH = 0.1
"""Metres of a bone that a segmentation must miss to be mistrusted: joints err by less."""
HULL = 2.0
"""Log odds, without a segmentation, against what joints say where the other views do not confirm it."""
HANDS = ("Wrist", "Pinky", "Index", "Thumb", "Hand")
"""Joints of a hand, without their side."""
HOLDING, MAY_HOLD, HELD_UNSEEN = 0.35, -1.5, -3.0
"""Metres about the joints of a hand in which what it holds may lie; the least log odds there before a plate has spoken,
whatever the segmentation says; and the most where the other views' segmentations rule the subject out, which count a
helmet to nobody in any view. With -1.5 pieces of wall beside the board of `desk` come in."""
FEET = ("Ankle", "Heel", "FootIndex", "BigToe", "SmallToe")
"""Joints of a foot, without their side."""
STANDING = 0.25
"""Metres about the joints of a foot within which the ground is in its shadow, which a segmentation often counts to the
foot."""
FAINT = 0.15
"""Segmentation from which on the subject may be there."""
METRE_OF_SIDE = 0.4
"""Pixels of a metre over those of a region's side: a region around a person who stands is about 2.5 m wide."""


@dataclass(frozen=True, eq=False)
class Known:
    """What is known of the subject in one picture before its pixels are looked at."""

    hint: np.ndarray | None
    """[h, w] float32 0..1 segmentation, negative where the estimator did not look; None where it found nobody."""
    joints: np.ndarray
    """[J, 3] (u, v, score) px of the picture; score 0 = unknown."""
    joint_set: str
    """Their joint set."""
    possible: np.ndarray | None
    """[h, w] float32 0..1: where the other views allow the subject; None where none saw the subject."""
    confirmed: np.ndarray | None
    """[h, w] float32 0..1: where the other views all saw the subject."""
    alone: bool = False
    """Whether nobody else is known to be there, so that what lies at a hand is held by it."""
    others: Others | None = None
    """Where somebody else is; None where nobody is known to be."""
    scale: float = 0.0
    """Pixels of a metre at the subject, times its size over a grown person's; 0 where no joint is known in space."""


def person_matte(
    picture: np.ndarray, known: Known, plate: tuple[np.ndarray, np.ndarray] | None, threshold: float, margin: float
) -> np.ndarray | None:
    """Soft foreground [h, w] uint8 of the subject in a picture [h, w, 3] uint8; None where nothing is known of it.

    plate: the background [h, w, 3] and its spread [h, w], uint8, of a static camera; threshold in 1/255 as of
    `matte.plate_distance`; margin: share of a person's region by which a segmentation may be off.
    """
    scale = _scale(known)
    size = (picture.shape[1], picture.shape[0])
    hands = _about(known, HANDS, size, HOLDING * scale) & (
        plate[1] < UNSEEN if plate is not None and known.alone else False
    )
    prior = _prior(known, hands, scale, margin * scale / METRE_OF_SIDE) if scale > 0 else None
    if prior is None or not (prior > 0).any():
        return None
    box = part_around(prior > RULED_OUT / 2, compared_beyond(scale))
    prior, shown = np.ascontiguousarray(prior[box]), np.ascontiguousarray(picture[box])
    against = None
    if plate is not None:
        ground, spread = (np.ascontiguousarray(a[box]) for a in plate)
        # Without a segmentation feet are where their joints are, and shoes as dark as a shadow would be lost.
        grounded = _about(known, FEET, size, STANDING * scale)[box] & (known.hint is not None)
        shadow = shadow_density(shown, ground, spread, grounded, prior)
        against = Plate(shown, ground, spread, threshold, prior <= RULED_OUT / 2, shadow)
    odds = along_edges(shown, prior, scale, against)
    out = np.zeros(picture.shape[:2], np.uint8)
    mask = without_specks(odds > 0, prior > 0)
    if known.hint is not None and plate is not None:
        mask &= ~_ghosts(mask, hands[box] & (prior <= MAY_HOLD), shown, ground)
        mask |= _holes_in_things(mask, hands[box] & (prior <= 0))
    out[box] = soft_edge(shown, mask)
    return out


def _scale(known: Known) -> float:
    """Pixels of a metre at the subject, from its limbs in the picture, of which each is a lower bound, and where joints
    stand in for a segmentation also from where it is; from the extent of what was seen where none of these tells.

    Beside a segmentation margins and windows alone hang on the scale, and those fitted to limbs are exact enough: wider
    ones lose .01 of IoU of somebody filmed from head to waist.
    """
    scale = pixels_per_metre(known.joints, known.joint_set)
    if known.hint is None:
        scale = max(scale, known.scale)
    for field in (known.hint, known.confirmed):
        if scale <= 0 and field is not None and (field > 0.5).any():
            scale = max(float(np.ptp(n)) for n in np.nonzero(field > 0.5)) / STATURE
    return scale


def _prior(known: Known, hands: np.ndarray, scale: float, reach: float) -> np.ndarray | None:
    """[h, w] float32 log odds of the subject in a picture before it is looked at; None where nothing is known.

    hands [h, w] bool: where something held may lie and a plate tells; scale: px of a metre; reach: px by which a
    segmentation may be off.
    """
    size = (hands.shape[1], hands.shape[0])
    body = body_shape(known.joints, known.joint_set, size, scale)
    others = np.zeros(body.shape, bool) if known.others is None else known.others.anywhere
    body &= ~others
    if known.hint is not None:
        prior = _of_hint(known.hint, reach)
        prior = np.where(hands, np.maximum(prior, MAY_HOLD), prior)
        if known.confirmed is not None:
            missed = (
                limb_bones(known.joints, known.joint_set, size, BONE * scale)
                & (known.confirmed > 0.5)
                & (distance_to(known.hint > 0.5) > reach)
            )
            missed = _long(missed & ~others, MISSED_LENGTH * scale)
            if missed.any():
                limb = np.minimum(-_signed(body) / (SKIN * scale), GIVEN_BACK)
                prior = np.where(distance_to(missed) < 2 * reach, np.maximum(prior, limb), prior)
    elif body.any():
        prior = -_signed(body) / (SKIN * scale)
        if known.confirmed is not None:
            prior += HULL * (known.confirmed - 1)
        prior = np.clip(prior, RULED_OUT, FAR_INSIDE)
    elif known.confirmed is not None and not _outside(known, size):
        prior = logit(known.confirmed, HINT_FLOOR)
    else:
        return None
    if known.possible is not None:
        # Joints are triangulated: where they are, other views saw the subject, whatever their segmentation says.
        ruled_out = np.where(hands, np.minimum(prior, HELD_UNSEEN), RULED_OUT)
        prior = np.where((known.possible < 0.5) & ~body, ruled_out, prior)
    prior = np.where(others, RULED_OUT, prior)
    return prior.astype(np.float32)


def _outside(known: Known, size: tuple[int, int]) -> bool:
    """Whether joints are known, and all of them lie beside a picture of `size` (width, height): then other views that
    confirm its rim, coarse as they are, say nothing that a plate does not say better."""
    joints = known.joints[known.joints[:, 2] > 0, :2]
    return len(joints) > 0 and not ((joints >= 0) & (joints <= size)).all(axis=1).any()


def _about(known: Known, joints: tuple[str, ...], size: tuple[int, int], reach: float) -> np.ndarray:
    """[h, w] bool: pixels of a picture of `size` (width, height) that lie at most `reach` px from one of the joints,
    named without their side."""
    out = np.zeros((size[1], size[0]), np.uint8)
    for name, (u, v, score) in zip(joint_set(known.joint_set).names, known.joints, strict=True):
        if score > 0 and name[1:] in joints and np.abs([u, v]).max() < 4 * max(size):
            cv2.circle(out, (round(u), round(v)), round(reach), 1, -1)
    return out > 0


def _of_hint(hint: np.ndarray, reach: float) -> np.ndarray:
    """[h, w] log odds: the segmentation's own around its edge, firm farther from it than it may be off."""
    beyond = np.clip(distance_to(hint > FAINT) / reach - 0.5, 0, 1)
    within = np.clip(distance_to(hint <= 0.5) / reach - 0.5, 0, 1)
    return np.where(hint < 0, RULED_OUT, logit(hint, HINT_FLOOR) + RULED_OUT * beyond + FAR_INSIDE * within)


def _signed(shape: np.ndarray) -> np.ndarray:
    """[h, w] float32 px outside a shape's edge, negative inside."""
    return np.where(shape, 0.5 - distance_to(~shape), distance_to(shape) - 0.5)


def _long(shape: np.ndarray, length: float) -> np.ndarray:
    """[h, w] bool: the parts of a shape whose bounding box has a diagonal of at least `length` px."""
    _, labels, stats, _ = cv2.connectedComponentsWithStats(shape.astype(np.uint8), connectivity=8)
    kept = np.hypot(stats[:, cv2.CC_STAT_WIDTH], stats[:, cv2.CC_STAT_HEIGHT]) >= length
    kept[0] = False
    return kept[labels]


def _ghosts(mask: np.ndarray, told: np.ndarray, picture: np.ndarray, plate: np.ndarray) -> np.ndarray:
    """[h, w] bool: parts of a mask [h, w] bool that the plate alone told of, `told` [h, w] bool, and whose rim is an
    edge of the plate [h, w, 3] rather than of the picture [h, w, 3]: what stood there has gone and is in the plate.

    On `balance` and `desk` the picture is 1.5 to 29 times as steep as the plate where the board ends, and 0.3 to 1.0
    times where the plate kept the subject's own shoulder, hair or shorts, which were hardly ever out of the way.
    """
    count, labels = cv2.connectedComponents((mask & told).astype(np.uint8), connectivity=8)
    rims = np.where(_beside(~mask), labels, 0)
    rims = cv2.dilate(rims.astype(np.float32), np.ones((3, 3), np.uint8)).astype(np.int64)
    shown, kept = (np.bincount(rims.ravel(), _steepness(a).ravel(), minlength=count) for a in (picture, plate))
    ghosts = shown < kept
    ghosts[0] = False
    return np.asarray(ghosts[labels])


def _beside(shape: np.ndarray) -> np.ndarray:
    """[h, w] bool: a shape [h, w] bool and the pixels beside it."""
    return cv2.dilate(shape.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0


def _steepness(picture: np.ndarray) -> np.ndarray:
    """[h, w] float32 slope of a picture [h, w, 3] of 0..255, all colours together, noise evened out."""
    smooth = cv2.GaussianBlur(picture, (0, 0), 1.0).astype(np.float32)
    return np.hypot(*(np.linalg.norm(cv2.Sobel(smooth, cv2.CV_32F, *d), axis=2) for d in ((1, 0), (0, 1))))


def _holes_in_things(mask: np.ndarray, thing: np.ndarray) -> np.ndarray:
    """[h, w] bool: holes of a mask [h, w] bool most of whose rim lies in what is held, `thing` [h, w] bool: there a
    part of it looks like what is behind. Those between arm and body are none of them."""
    count, labels = cv2.connectedComponents((~mask).astype(np.uint8), connectivity=4)
    beside = np.where(mask, cv2.dilate(labels.astype(np.float32), np.ones((3, 3), np.uint8)), 0).astype(np.int64)
    around, held = np.bincount(beside.ravel(), minlength=count), np.bincount(beside[thing], minlength=count)
    filled = held > 0.5 * around
    filled[np.unique(np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]]))] = False
    filled[0] = False
    return np.asarray(filled[labels])
