"""Joints of the pose benchmark: spoilt as detectors spoil them, and compared with the truth in the body's own axes."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np

from posegaussian.stages.pose.bridge import Bones
from posegaussian.stages.simulator.effects.base import generator
from posegaussian.stages.simulator.effects.joint_noise import JointNoise, apply
from posegaussian.storage.model.joint_sets import COCO17

NAMES = COCO17.names
_FACE = [NAMES.index(n) for n in ("Nose", "LEye", "REye", "LEar", "REar")]
_SHOULDERS, _HIPS, _EARS = ([NAMES.index(s + n) for s in "LR"] for n in ("Shoulder", "Hip", "Ear"))


@dataclass(frozen=True)
class Spoil:
    """What a detector does to exact joints."""

    name: str
    noise: JointNoise
    hidden_doubtful: bool = True
    """Whether a hidden joint has twice the noise."""
    hidden_missing: float = 0.0
    """Share of the hidden joints that are not found at all."""
    views_exchanged: float = 0.0
    """Share of the pictures in which left and right change places: of the body, the legs or the arms."""
    frames_exchanged: float = 0.0
    """Share of the frames in which they do so in every view."""


CLEAN = Spoil("1 px", JointNoise(switch="on", pixels=1.0, dropouts=0.0, outliers=0.0), hidden_doubtful=False)
SPOILT = JointNoise(switch="on", pixels=4.0, dropouts=0.1, outliers=0.02)
SPOILS = (
    CLEAN,
    Spoil("4 px, 10 % missing, 2 % elsewhere", SPOILT),
    Spoil(
        "and hidden ones missing, sides exchanged",
        SPOILT,
        hidden_missing=0.9,
        views_exchanged=0.1,
        frames_exchanged=0.05,
    ),
)
_PARTS = (tuple(range(1, 17)), tuple(range(11, 17)), tuple(range(5, 11)))


def spoilt(exact: np.ndarray, spoil: Spoil, seed: int) -> np.ndarray:
    """Exact joints [F, V, 17, 3] (u, v px, 1 visible or 0 hidden) -> [F, V, 17, 3] (u, v, score)
    as a detector gives them."""
    out = np.empty(exact.shape)
    flips = np.array(COCO17.flips)
    for f in range(len(exact)):
        of_frame = generator(seed, "exchanged", f)
        whole = of_frame.random() < spoil.frames_exchanged
        for v in range(exact.shape[1]):
            visible = exact[f, v, :, 2] > 0
            shot = SimpleNamespace(frame=f, view=v, visible=visible if spoil.hidden_doubtful else np.ones(17, bool))
            joints = apply(np.column_stack([exact[f, v, :, :2], np.ones(17)]), shot, spoil.noise, seed)
            random = generator(seed, "exchanged", f, v)
            joints[~visible & (random.random(17) < spoil.hidden_missing)] = 0.0
            if whole or random.random() < spoil.views_exchanged:
                part = np.isin(np.arange(17), _PARTS[0 if whole else int(random.integers(3))])
                joints = np.where(part[:, None], joints[flips], joints)
            out[f, v] = joints
    return out


def body_axes(truth: np.ndarray) -> np.ndarray:
    """[F, 17, 3, 3] axes (forward, left, up in rows) that turn with each joint's own part of the body, of true joints
    [F, 17, 3].

    Those of shoulders or hips and the spine, turned with a limb by the smallest rotation that takes "down" to the limb;
    of the face, those of ears and nose.
    """
    up = _unit(truth[:, _SHOULDERS].mean(axis=1) - truth[:, _HIPS].mean(axis=1))
    chest, pelvis = (_axes(up, truth[:, a] - truth[:, b]) for a, b in (_SHOULDERS, _HIPS))
    out = np.repeat(chest[:, None], 17, axis=1)
    out[:, _HIPS[0] :] = pelvis[:, None]
    ears = truth[:, _EARS[0]] - truth[:, _EARS[1]]
    ahead = truth[:, NAMES.index("Nose")] - truth[:, _EARS].mean(axis=1)
    out[:, _FACE] = _axes(_unit(np.cross(ahead, ears)), ears)[:, None]
    parents = Bones.of("coco17").parents
    for j, name in enumerate(NAMES):
        if name[1:] in ("Elbow", "Wrist", "Knee", "Ankle"):
            limb = _unit(truth[:, j] - truth[:, parents[j]])
            out[:, j] = np.einsum("fab,fcb->fca", _least_turn(-up, limb), out[:, j])
    return out


def _unit(v: np.ndarray) -> np.ndarray:
    return np.asarray(v / np.linalg.norm(v, axis=-1, keepdims=True))


def _axes(up: np.ndarray, left: np.ndarray) -> np.ndarray:
    """[F, 3, 3] forward, left and up in rows; `up` is kept."""
    forward = _unit(np.cross(left, up))
    return np.stack([forward, np.cross(up, forward), up], axis=1)


def _least_turn(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """[F, 3, 3] smallest rotations of unit vectors a to b [F, 3] (Rodrigues)."""
    v, c = np.cross(a, b), (a * b).sum(-1)
    k = np.zeros((len(a), 3, 3))
    k[:, 0, 1], k[:, 0, 2], k[:, 1, 2] = -v[:, 2], v[:, 1], -v[:, 0]
    k = k - k.transpose(0, 2, 1)
    return np.asarray(np.eye(3) + k + k @ k / np.maximum(1.0 + c, 1e-6)[:, None, None])


def offsets(points: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """[F, 17, 3] metres forward, left and up from true joints [F, 17, 3] to found ones [F, 17, 4];
    NaN where unknown."""
    off = np.where(points[..., 3:] > 0, points[..., :3] - truth, np.nan)
    return np.einsum("fjab,fjb->fja", body_axes(truth), off)


def constant_of(found: np.ndarray) -> np.ndarray:
    """[17, 3] the median of offsets [N, 17, 3];
    what a name means is the same on both sides but for the sign of left."""
    mirrored = found[:, list(COCO17.flips)] * [1.0, -1.0, 1.0]
    return np.asarray(np.nanmedian(np.concatenate([found, mirrored]), axis=0))


def without_offset(points: np.ndarray, truth: np.ndarray, constant: np.ndarray) -> np.ndarray:
    """Found joints [F, 17, 4] less the constant offset [17, 3] of what each name means."""
    shift = np.einsum("fjab,ja->fjb", body_axes(truth), constant)
    return np.concatenate([points[..., :3] - shift, points[..., 3:]], axis=-1)
