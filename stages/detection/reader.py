"""2D joints of single source frames, from files or from the pictures: the survey looks at few frames and waits for no other stage."""

from __future__ import annotations

from collections import OrderedDict
from typing import ClassVar
from weakref import WeakKeyDictionary

import numpy as np

from stages.detection.estimator import Estimator
from stages.frames.display import to_display
from stages.io import Inputs, JointReader, PictureReader
from storage.joints import joint_set

PEOPLE = 3
"""People looked for in a picture."""


KEPT = 4096
"""Pictures whose joints a process keeps: all that a survey of twenty views looks at."""


class EstimatedJoints:
    """`stages.io.JointReader` over pictures: what was found in a picture is kept for whoever asks next in this process."""

    _kept: ClassVar[WeakKeyDictionary[Estimator, OrderedDict[str, np.ndarray]]] = WeakKeyDictionary()

    def __init__(self, pictures: PictureReader, estimator: Estimator) -> None:
        self._pictures, self._estimator = pictures, estimator
        self.joint_set = estimator.joint_set

    def read(self, view: int, number: int) -> np.ndarray:
        """[people, J, 3] float64 (u, v, score) in captured pixels; nobody in a frame the view lacks."""
        if number not in self._pictures.numbers(view):
            return np.zeros((0, len(joint_set(self.joint_set)), 3))
        kept, key = self._kept.setdefault(self._estimator, OrderedDict()), self._pictures.identity(view, number)
        if key not in kept:
            (picture,) = self._pictures.read(view, [number])
            kept[key] = np.asarray(self._estimator.find(to_display(picture), PEOPLE).joints, dtype=np.float64)
            if len(kept) > KEPT:
                kept.popitem(last=False)
        return kept[key]


def joint_reader(inputs: Inputs) -> JointReader:
    """The 2D joints of a capture that has some, given or estimated."""
    if "detected" not in inputs.facts:
        return inputs.source("joints")
    return EstimatedJoints(inputs.source("pictures"), inputs.source("estimator"))
