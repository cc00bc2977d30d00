"""Pictures turned upright before an estimator looks for people: it was trained on people who stand or sit upright.

Only quarter turns: they move pixels and change none, and an estimator bears what is left, 45 degrees at most.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from posegaussian.stages.estimators.interface import Estimator, Found
from posegaussian.stages.geometry.subject import up_direction
from posegaussian.storage.model.cameras import Rig

STEEP = 0.3
"""Length of the rig's up in a picture's plane below which the camera looks so steeply that no side is up."""


def quarter_turns(rig: Rig, view: int) -> int:
    """How many quarters a view's picture must be turned counter-clockwise for the rig's up to be up in it, 0 to 3."""
    right, down = rig.rotations[view, :2] @ up_direction(rig)
    if np.hypot(right, down) < STEEP:
        return 0
    return int(np.rint(np.arctan2(right, -down) / (np.pi / 2))) % 4


@dataclass(frozen=True, eq=False)
class Turned:
    """An estimator that is shown pictures turned by quarters, and answers in the pictures as they are."""

    estimator: Estimator
    quarters: int
    """Counter-clockwise."""

    @property
    def joint_set(self) -> str:
        """The estimator's."""
        return self.estimator.joint_set

    def find(self, picture: np.ndarray, most: int) -> Found:
        """People in a picture [h, w, 3] uint8 sRGB, as `Estimator.find`."""
        if self.quarters == 0:
            return self.estimator.find(picture, most)
        found = self.estimator.find(np.ascontiguousarray(np.rot90(picture, self.quarters)), most)
        height, width = picture.shape[:2]
        joints, region = found.joints.copy(), found.region.copy()
        joints[..., :2] = turned_back(joints[..., :2], (width, height), self.quarters)
        region[..., :2] = turned_back(region[..., :2], (width, height), self.quarters)
        region[..., 3] = self.leaning(region)[..., 3]
        return replace(found, joints=joints, region=region)

    def look(self, picture: np.ndarray, regions: np.ndarray) -> Found:
        """Landmarks in regions [P, 4] of the picture as it is, as `Estimator.look`: regions have angles."""
        return self.estimator.look(picture, regions)

    def leaning(self, regions: np.ndarray) -> np.ndarray:
        """Regions [..., 4] that are upright in the turned picture -> as upright as people are in the picture."""
        out = np.array(regions)
        out[..., 3] = (out[..., 3] + self.quarters * np.pi / 2 + np.pi) % (2 * np.pi) - np.pi
        return out


def turned_back(points: np.ndarray, size: tuple[int, int], quarters: int) -> np.ndarray:
    """Points [..., 2] px of a picture that was turned counter-clockwise -> of the picture itself, of size (width,
    height)."""
    c, s = ((1, 0), (0, 1), (-1, 0), (0, -1))[quarters]
    middle = np.array(size) / 2
    turned_middle = middle[::-1] if quarters % 2 else middle
    return (np.asarray(points) - turned_middle) @ np.array([[c, s], [-s, c]], dtype=np.float64) + middle
