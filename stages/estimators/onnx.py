"""Any heatmap or SimCC network the user describes,
run top-down through OpenCV's DNN in regions that somebody else finds."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from posegaussian.stages.estimators.description import Description
from posegaussian.stages.estimators.interface import PERSON_SIDE, Estimator, Found, seen_inside
from posegaussian.stages.estimators.outputs import read_heatmaps, read_simcc
from posegaussian.stages.imaging.regions import crop, to_picture, whole
from posegaussian.storage.model.errors import ConfigError
from posegaussian.storage.model.joint_sets import joint_map, joint_set


class OnnxEstimator:
    """The network of a description. One object serves one thread.

    It finds nobody by itself: `find` looks in the regions of `finder` (BlazePose, say), or at the whole picture where
    there is none. Whoever knows where the person is calls `look`, for example with `regions.around` of a box.
    """

    def __init__(self, description: Description, finder: Estimator | None = None) -> None:
        """Open the network; ConfigError for a file that OpenCV cannot read."""
        self.joint_set = description.joint_set
        self._d = description
        self._finder = finder
        try:
            self._net = cv2.dnn.readNetFromONNX(str(description.path))
        except cv2.error as e:
            raise ConfigError(
                f"{description.path}: OpenCV's DNN cannot read it ({_sentence(e)}); export it with a lower opset, fixed"
                " sizes and no post-processing"
            ) from e
        w, h = description.input
        self._share = np.array([w, h]) / max(w, h) * description.margin
        """Width and height of the crop over the region's side."""
        self._to_coco = joint_map(description.joint_set, "coco17")

    @property
    def where(self) -> str:
        """A sentence: in which regions `find` looks."""
        return (
            f"people are found by {type(self._finder).__name__}"
            if self._finder
            else "no detector is there: one person is looked for in the whole picture"
        )

    def find(self, picture: np.ndarray, most: int) -> Found:
        """At most `most` people in a picture [h, w, 3] uint8 sRGB, sorted by presence."""
        seen = None if self._finder is None else self._finder.find(picture, most)
        regions = whole((picture.shape[1], picture.shape[0]))[None] if seen is None else seen.region
        people = self._people(picture, regions, seen)
        return people.pick(np.argsort(-people.presence, kind="stable").tolist())

    def look(self, picture: np.ndarray, regions: np.ndarray) -> Found:
        """Landmarks in the given regions [P, 4], one person each in the same order;
        presence is the mean score of the joints."""
        return self._people(picture, regions, None if self._finder is None else self._finder.look(picture, regions))

    def _people(self, picture: np.ndarray, regions: np.ndarray, seen: Found | None) -> Found:
        """One person a region [P, 4], with the segmentation by whoever finds people, who looked in the same regions."""
        people = Found.together(
            [self._look(picture, r) for r in np.asarray(regions, dtype=np.float64)], len(joint_set(self.joint_set))
        )
        return people if seen is None else replace(people, person=seen.person)

    def _look(self, picture: np.ndarray, region: np.ndarray) -> Found:
        d = self._d
        values = crop(picture, region, d.input, share=self._share).astype(np.float32)
        if d.channels == "bgr":
            values = values[..., ::-1]
        fed = (values * np.float32(d.scale) - np.array(d.mean, np.float32)) / np.array(d.std, np.float32)
        outputs = self._run(np.ascontiguousarray(fed.transpose(2, 0, 1)[None]))
        read = (
            read_heatmaps(outputs[0], d, self._share)
            if d.kind == "heatmap"
            else read_simcc(outputs[0], outputs[1], d, self._share)
        )
        places = to_picture(read.places, region)
        scores = np.clip(read.peaks * d.score_scale, 0, 1)
        joints, _ = seen_inside(np.concatenate([places, scores[:, None]], axis=1), (picture.shape[1], picture.shape[0]))
        return Found(
            joints[None],
            region.astype(np.float32)[None],
            self._in_coco(read.maps * scores[:, None, None])[None],
            np.zeros((1, PERSON_SIDE, PERSON_SIDE), np.uint8),
            joints[:, 2].mean(keepdims=True),
        )

    def _in_coco(self, maps: np.ndarray) -> np.ndarray:
        """[17, 64, 64] float16: the maps [J, 64, 64] of the COCO-17 joints, zero for one that the network lacks."""
        return np.where((self._to_coco >= 0)[:, None, None], maps[self._to_coco], 0).astype(np.float16)

    def _run(self, blob: np.ndarray) -> list[np.ndarray]:
        """The named outputs without their batch axis, checked for their shape."""
        d, count = self._d, len(joint_set(self.joint_set))
        self._net.setInput(blob)
        try:
            outputs = [np.atleast_1d(o)[0] for o in self._net.forward(list(d.outputs))]
        except cv2.error as e:
            raise ConfigError(
                f"{d.path}: OpenCV's DNN cannot run it for outputs {', '.join(d.outputs)} and an input of {d.input[0]}"
                f" x {d.input[1]} px ({_sentence(e)}); look at the names and sizes in the file"
            ) from e
        axes = 3 if d.kind == "heatmap" else 2
        for name, o in zip(d.outputs, outputs, strict=True):
            if np.ndim(o) != axes or len(o) != count:
                raise ConfigError(
                    f"{d.path}: output {name} has the shape {list(np.shape(o))}; a {d.kind} network of {self.joint_set}"
                    f" gives {count} joints by {axes - 1} more ax{'es' if axes == 3 else 'is'}"
                )
            if not np.isfinite(o).all():
                raise ConfigError(
                    f"{d.path}: output {name} is not finite; look at scale, mean and std of the description"
                )
        return outputs


def _sentence(error: cv2.error) -> str:
    return str(error).strip().splitlines()[-1].strip()
