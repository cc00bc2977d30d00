"""What every estimator of 2D joints gives: the people of one picture, and the interface by which it is asked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

MAP_SIDE = 64
"""Cells along a side of a heatmap."""
PERSON_SIDE = 256
"""Cells along a side of a person's segmentation."""


@dataclass(frozen=True, eq=False)
class Found:
    """P people found in one picture."""

    joints: np.ndarray
    """[P, J, 3] float32 (u, v, score 0..1), px of the picture, our pixel centres;
    a joint outside the picture has score 0."""
    region: np.ndarray
    """[P, 4] float32 (centre u, centre v, side, angle):
    square crop the landmarks were read in, px / rad; see `posegaussian.stages.imaging.regions`."""
    heatmaps: np.ndarray
    """[P, 17, 64, 64] float16 in COCO-17 order, 0..1; the centre of cell (i, j) is at ((j + .5)/64, (i + .5)/64) of
    the region; zero where the model has no map."""
    person: np.ndarray
    """[P, 256, 256] uint8 soft segmentation of the person over the region, 0..255; zero where the model gives none."""
    presence: np.ndarray
    """[P] float32 how sure the estimator is that the region holds a person, 0..1."""

    def __len__(self) -> int:
        return len(self.joints)

    def pick(self, order: Sequence[int]) -> Found:
        """The given people, in the given order."""
        i = np.asarray(order, dtype=np.int64)
        return Found(self.joints[i], self.region[i], self.heatmaps[i], self.person[i], self.presence[i])

    @staticmethod
    def nobody(joints: int) -> Found:
        """No people, of a joint set with that many joints."""
        f32 = np.float32
        return Found(
            np.zeros((0, joints, 3), f32),
            np.zeros((0, 4), f32),
            np.zeros((0, 17, MAP_SIDE, MAP_SIDE), np.float16),
            np.zeros((0, PERSON_SIDE, PERSON_SIDE), np.uint8),
            np.zeros(0, f32),
        )

    @staticmethod
    def together(parts: Sequence[Found], joints: int) -> Found:
        """The people of several, one after the other."""
        every = (Found.nobody(joints), *parts)
        return Found(
            *(
                np.concatenate([getattr(p, name) for p in every])
                for name in ("joints", "region", "heatmaps", "person", "presence")
            )
        )


class Estimator(Protocol):
    """Finds people in a picture. One object serves one thread; equal pictures give equal bytes."""

    joint_set: str
    """Id in `posegaussian.storage.model.joint_sets.JOINT_SETS` of the joints it names."""

    def find(self, picture: np.ndarray, most: int) -> Found:
        """People in a picture [h, w, 3] uint8 sRGB, sorted by presence, at most `most`."""

    def look(self, picture: np.ndarray, regions: np.ndarray) -> Found:
        """Landmarks in the given regions [P, 4] (centre u, centre v, side, angle), one person each in the same
        order, without a detector."""


def seen_inside(joints: np.ndarray, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Joints [J, 3] float32 with score 0 where they lie outside a picture of size (width, height), and [J] which lie
    inside: what is not pictured was not seen."""
    inside = np.all((joints[:, :2] >= 0) & (joints[:, :2] <= size), axis=1)
    return np.concatenate([joints[:, :2], joints[:, 2:] * inside[:, None]], axis=1).astype(np.float32), inside
