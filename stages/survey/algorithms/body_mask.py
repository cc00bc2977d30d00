"""Where people stand in a sampled picture, as far as joints tell: pixels that a background plate must not learn
from."""

from __future__ import annotations

import cv2
import numpy as np

from posegaussian.storage.model.cameras import points_to_integer_centres
from posegaussian.storage.model.joint_sets import joint_set

TORSO = ("LShoulder", "RShoulder", "RHip", "LHip")


def people_cover(people: np.ndarray, joint_set_id: str, size: tuple[int, int], margin: float) -> np.ndarray:
    """[h, w] uint8, 1 where a person may be: limbs and torso, widened on each side by `margin` times the person's
    extent.

    people [n, J, 3] (u, v, score) in pixels of the picture of `size` (width, height), our pixel centres; joints of
    score 0 are unknown. The extent is the longer side of the box around a person's joints.
    """
    cover = np.zeros((size[1], size[0]), dtype=np.uint8)
    known_set = joint_set(joint_set_id)
    torso = [known_set.names.index(n) for n in TORSO if n in known_set.names]
    for person in people:
        known = person[:, 2] > 0
        if not known.any():
            continue
        reach = 4.0 * max(size)
        points = np.rint(np.clip(points_to_integer_centres(person[:, :2]), -reach, reach)).astype(np.int32)
        radius = max(1, round(margin * float(np.ptp(points[known], axis=0).max())))
        for a, b in known_set.limbs:
            if known[a] and known[b]:
                cv2.line(cover, points[a].tolist(), points[b].tolist(), 1, 2 * radius)
        for point in points[known]:
            cv2.circle(cover, point.tolist(), radius, 1, -1)
        if len(torso) == len(TORSO) and known[torso].all():
            cv2.fillConvexPoly(cover, cv2.convexHull(points[torso]), 1)
    return cover
