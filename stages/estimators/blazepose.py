"""BlazePose: people detected in a picture, their landmarks read in a region that follows them, heatmaps and
segmentation beside.

A joint's score is the peak of its heatmap times visibility, presence and the region's flag, and a person's presence the
flag times the mean peak of the COCO-17 joints inside the picture: against joints known otherwise, visibility alone
hardly tells wrong ones (area under the curve .73 for errors over 100 px of 1920, with the peak .96), and a body seen
where none is, or upside down, has a flag of .9 to 1, but peaks of .4 where real ones have .7 to .9.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import cv2
import numpy as np

from posegaussian.stages.estimators.anchors import INPUT, anchors
from posegaussian.stages.estimators.blazepose_files import check_files, missing_sentence, model_files
from posegaussian.stages.estimators.decoding import CROP, centred, detections, landmarks, sigmoid
from posegaussian.stages.estimators.interface import PERSON_SIDE, Found, seen_inside
from posegaussian.stages.estimators.litert import LiteRTNetwork
from posegaussian.stages.estimators.suppression import overlap
from posegaussian.stages.imaging.regions import crop, region_of, squares, to_picture, whole
from posegaussian.storage.model.errors import ConfigError
from posegaussian.storage.model.joint_sets import BLAZEPOSE33, joint_map

JOINTS = 33
"""Landmarks of the body; those after it serve the region."""
COCO17 = joint_map(BLAZEPOSE33.id, "coco17")
"""[17] BlazePose's landmark for each joint of COCO-17."""
CENTRE, RIM = 33, 34
"""Landmarks that say where the body's region is."""
LEAST_SCORE = 0.5
"""Detections below it are not looked at."""
LEAST_PRESENCE = 0.3
"""Below it a region holds nobody."""
ROUNDS = 3
"""Most times the landmarks are read again in the region they themselves give, unless more are asked for."""
STILL = 0.02
"""A region that moves, grows and turns by less than this share of its side is settled."""
TAKEN = 0.3
"""A detection whose region moves, grows and turns into a settled person's
by less than this share of its side is that person."""
SAME_PERSON = 0.5
"""Intersection over union of two bodies above which they are one person, found twice."""
SAME_CENTRE = 0.15
"""Distance of two regions' centres, as a share of the smaller side, below which they hold one person:
found upside down, say."""
ZOOMS = ((), (1.0,), (1.0, 0.5))
"""Shares of the picture's short side that the detector's squares have, beside the whole picture, for each zoom."""


class BlazePose:
    """The official three models, on one thread; one object serves one thread, equal pictures give equal bytes."""

    joint_set = BLAZEPOSE33.id

    def __init__(self, files: Mapping[str, Path] | None = None, rounds: int = ROUNDS, zoom: int = 1) -> None:
        """Open the models of `files` (see `models.model_files`), by default the fetched ones; ConfigError where they or
        LiteRT are missing, SourceError where one is not what was published.

        Landmarks are read again up to `rounds` times in the region they themselves give. The detector needs people to
        be about a fifth of what it is shown: zoom 0 shows it the whole picture; 1, where it sees nobody there, squares
        along the long side, too; 2 always these and squares half as wide, for people small in the picture.
        """
        found = files or model_files()
        if found is None:
            raise ConfigError(missing_sentence())
        check_files(found)
        self._detector = LiteRTNetwork(found["pose_detection"])
        self._landmarks = LiteRTNetwork(found["pose_landmark_full"])
        self._anchors = anchors()
        self._rounds, self._zoom = rounds, zoom

    def find(self, picture: np.ndarray, most: int) -> Found:
        """At most `most` people in a picture [h, w, 3] uint8 sRGB, sorted by presence."""
        people = self._settle(picture, self.detect(picture))
        people = people.pick(np.argsort(-people.presence, kind="stable").tolist())
        return people.pick(distinct(people)[:most])

    def detect(self, picture: np.ndarray) -> np.ndarray:
        """[D, 4] regions in which the detector sees people, by falling score:
        in the whole picture and in squares of it."""
        size = (picture.shape[1], picture.shape[0])
        found = [self._detect_in(picture, whole(size))]
        if self._zoom == 2 or not len(found[0][0]):
            found += [self._detect_in(picture, place) for share in ZOOMS[self._zoom] for place in squares(size, share)]
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
                if distance(region, own) < STILL:
                    break
                region = own
                person, own = self._look(picture, region)
            if person.presence[0] >= LEAST_PRESENCE:
                people.append(person)
        return Found.together(people, JOINTS)

    def _look(self, picture: np.ndarray, region: np.ndarray) -> tuple[Found, np.ndarray]:
        """One region's landmarks, and the region [4] that they give;
        read exactly where the region, as it is told, lies."""
        region = np.asarray(region, dtype=np.float32).astype(np.float64)
        values = crop(picture, region, (CROP, CROP), cv2.BORDER_REPLICATE).astype(np.float32) * np.float32(1 / 255)
        raw, flag, person, maps, _world = self._landmarks(values)
        heatmaps = sigmoid(maps)
        own, scores = landmarks(raw, heatmaps)
        places = to_picture(own, region)
        certain = heatmaps[:, :, :JOINTS].max((0, 1))
        joints = np.concatenate([places[:JOINTS], (flag * scores[:JOINTS] * certain)[:, None]], axis=1)
        joints, inside = seen_inside(joints, (picture.shape[1], picture.shape[0]))
        found = Found(
            joints[None],
            region.astype(np.float32)[None],
            centred(heatmaps[:, :, COCO17]).transpose(2, 0, 1).astype(np.float16)[None],
            np.rint(255 * sigmoid(person)).astype(np.uint8).reshape(1, PERSON_SIDE, PERSON_SIDE),
            flag * np.float32((certain * inside)[COCO17].sum() / max(1, np.count_nonzero(inside[COCO17]))),
        )
        return found, region_of(places[CENTRE], places[RIM])


def distance(before: np.ndarray, after: np.ndarray) -> float:
    """How far a region [4] moves, grows and turns to become another, as a share of its side."""
    turn = (after[3] - before[3] + np.pi) % (2 * np.pi) - np.pi
    return float((np.hypot(*(after[:2] - before[:2])) + abs(after[2] - before[2]) / 2) / before[2] + abs(turn) / 2)


def distinct(people: Found) -> list[int]:
    """Which of the people are not one found before: neither the boxes of their joints nor the centres of their
    regions fall together."""
    places = people.joints[..., :2]
    boxes = np.concatenate([places.min(1), places.max(1)], axis=1)
    kept: list[int] = []
    for i, region in enumerate(people.region):
        near = np.linalg.norm(people.region[kept, :2] - region[:2], axis=1) < SAME_CENTRE * np.minimum(
            people.region[kept, 2], region[2]
        )
        if not (near | (overlap(boxes[i], boxes[kept]) > SAME_PERSON)).any():
            kept.append(i)
    return kept
