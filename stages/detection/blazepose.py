"""BlazePose: people detected in a picture, their landmarks read in a region that follows them, heatmaps and segmentation beside."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import cv2
import numpy as np

from stages.detection.anchors import INPUT, anchors
from stages.detection.decoding import CROP, centred, detections, landmarks, sigmoid
from stages.detection.estimator import PERSON_SIDE, Found, seen_inside
from stages.detection.litert import Network
from stages.detection.models import check_files, missing_sentence, model_files
from stages.detection.regions import crop, region_of, squares, to_picture, whole
from stages.detection.suppression import overlap
from storage.errors import ConfigError

JOINTS = 33
"""Landmarks of the body; those after it serve the region."""
COCO17 = (0, 2, 5, 7, 8, 11, 12, 13, 14, 15, 16, 23, 24, 25, 26, 27, 28)
"""BlazePose's landmark for each joint of COCO-17."""
CENTRE, RIM = 33, 34
"""Landmarks that say where the body's region is."""
LEAST_SCORE = 0.5
"""Detections below it are not looked at."""
LEAST_PRESENCE = 0.5
"""Below it a region holds nobody."""
ROUNDS = 3
"""Most times the landmarks are read again in the region they themselves give, unless more are asked for."""
STILL = 0.02
"""A region that moves, grows and turns by less than this share of its side is settled."""
TAKEN = 0.3
"""A detection whose region moves, grows and turns into a settled person's by less than this share of its side is that person."""
SAME_PERSON = 0.5
"""Intersection over union of two bodies above which they are one person, found twice."""


class BlazePose:
    """The official three models, on one thread; one object serves one thread, equal pictures give equal bytes."""

    joint_set = "blazepose33"

    def __init__(self, files: Mapping[str, Path] | None = None, rounds: int = ROUNDS) -> None:
        """Open the models of `files` (see `models.model_files`), by default the fetched ones; ConfigError where they or LiteRT are missing, SourceError where one is not what was published.

        Landmarks are read again up to `rounds` times in the region they themselves give.
        """
        found = files or model_files()
        if found is None:
            raise ConfigError(missing_sentence())
        check_files(found)
        self._detector = Network(found["pose_detection"])
        self._landmarks = Network(found["pose_landmark_full"])
        self._anchors = anchors()
        self._rounds = rounds

    def find(self, picture: np.ndarray, most: int) -> Found:
        """At most `most` people in a picture [h, w, 3] uint8 sRGB, sorted by presence."""
        people = self._settle(picture, self.detect(picture))
        people = people.pick(np.argsort(-people.presence, kind="stable").tolist())
        return people.pick(distinct(people.joints)[:most])

    def detect(self, picture: np.ndarray) -> np.ndarray:
        """[D, 4] regions in which the detector sees people, by falling score: in the whole picture and in squares along its long side."""
        size = (picture.shape[1], picture.shape[0])
        found = [self._detect_in(picture, place) for place in (whole(size), *squares(size))]
        scores = np.concatenate([f[1] for f in found])
        return np.concatenate([f[0] for f in found])[np.argsort(-scores, kind="stable")]

    def look(self, picture: np.ndarray, regions: np.ndarray) -> Found:
        """Landmarks in the given regions [P, 4], one person each in the same order."""
        return Found.together([self._look(picture, r)[0] for r in np.asarray(regions, dtype=np.float64)], JOINTS)

    def _detect_in(self, picture: np.ndarray, place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Regions [D, 4] and scores [D] of the people in a square of the picture."""
        values = crop(picture, place, (INPUT, INPUT)).astype(np.float32) * np.float32(2 / 255) - np.float32(1)
        raw, logits = self._detector(values)
        seen = detections(raw, logits[:, 0], self._anchors, LEAST_SCORE)
        regions = [region_of(*to_picture(points[:2], place)) for points in seen.points]
        return np.array(regions).reshape(-1, 4), seen.scores

    def _settle(self, picture: np.ndarray, regions: np.ndarray) -> Found:
        """Whoever is in the regions [D, 4], read in the region their own landmarks give; empty regions are left out."""
        people: list[Found] = []
        for region in regions:
            if any(distance(region, p.region[0]) < TAKEN for p in people):
                continue
            person, own = self._look(picture, region)
            for _ in range(self._rounds):
                if person.presence[0] < LEAST_PRESENCE or distance(region, own) < STILL:
                    break
                region = own
                person, own = self._look(picture, region)
            if person.presence[0] >= LEAST_PRESENCE:
                people.append(person)
        return Found.together(people, JOINTS)

    def _look(self, picture: np.ndarray, region: np.ndarray) -> tuple[Found, np.ndarray]:
        """One region's landmarks, and the region [4] that they give."""
        values = crop(picture, region, (CROP, CROP), cv2.BORDER_REPLICATE).astype(np.float32) * np.float32(1 / 255)
        raw, flag, person, maps, _world = self._landmarks(values)
        heatmaps = sigmoid(maps)
        own, scores = landmarks(raw, heatmaps)
        places = to_picture(own, region)
        joints = np.concatenate([places, scores[:, None] * flag[0]], axis=1)[:JOINTS]
        found = Found(
            seen_inside(joints, (picture.shape[1], picture.shape[0]))[None],
            region.astype(np.float32)[None],
            centred(heatmaps[:, :, COCO17]).transpose(2, 0, 1).astype(np.float16)[None],
            np.rint(255 * sigmoid(person)).astype(np.uint8).reshape(1, PERSON_SIDE, PERSON_SIDE),
            flag.astype(np.float32),
        )
        return found, region_of(places[CENTRE], places[RIM])


def distance(before: np.ndarray, after: np.ndarray) -> float:
    """How far a region [4] moves, grows and turns to become another, as a share of its side."""
    turn = (after[3] - before[3] + np.pi) % (2 * np.pi) - np.pi
    return float((np.hypot(*(after[:2] - before[:2])) + abs(after[2] - before[2]) / 2) / before[2] + abs(turn) / 2)


def distinct(joints: np.ndarray) -> list[int]:
    """Which of the people [P, J, 3] are not one found before: their joints' boxes overlap it by SAME_PERSON at most."""
    boxes = np.concatenate([joints[..., :2].min(1), joints[..., :2].max(1)], axis=1)
    kept: list[int] = []
    for i in range(len(joints)):
        if not (overlap(boxes[i], boxes[kept]) > SAME_PERSON).any():
            kept.append(i)
    return kept
