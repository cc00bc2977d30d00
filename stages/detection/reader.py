"""2D joints of single source frames, from files or from the pictures: the survey looks at few frames and waits for
no other stage."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterable
from typing import ClassVar
from weakref import WeakKeyDictionary

import numpy as np

from posegaussian.stages.contract.facts import ESTIMATED
from posegaussian.stages.contract.io import Inputs, JointReader, PictureReader
from posegaussian.stages.estimators.interface import Estimator
from posegaussian.stages.estimators.turned import Turned, quarter_turns
from posegaussian.stages.imaging.color import to_display
from posegaussian.storage.model.cameras import Rig
from posegaussian.storage.model.joint_sets import joint_set

PEOPLE = 3
"""People looked for in a picture."""


KEPT = 4096
"""Pictures whose joints a process keeps: all that a survey of twenty views looks at."""


class EstimatedJoints:
    """`posegaussian.stages.contract.io.JointReader` over pictures, turned upright where the rig holds a camera rolled:
    what was found in a picture is kept for whoever asks next in this process."""

    _kept: ClassVar[WeakKeyDictionary[Estimator, OrderedDict[str, np.ndarray]]] = WeakKeyDictionary()

    def __init__(self, pictures: PictureReader, estimator: Estimator, rig: Rig) -> None:
        self._pictures, self._estimator = pictures, estimator
        self._turned = [Turned(estimator, quarter_turns(rig, v)) for v in range(len(rig))]
        self.joint_set = estimator.joint_set

    def read(self, view: int, number: int) -> np.ndarray:
        """[people, J, 3] float64 (u, v, score) in captured pixels; nobody in a frame the view lacks."""
        self.look_at(view, [number])
        nobody = np.zeros((0, len(joint_set(self.joint_set)), 3))
        return self._known.get(self._key(view, number), nobody) if number in self._pictures.numbers(view) else nobody

    def look_at(self, view: int, numbers: Iterable[int]) -> None:
        """Estimate what is not known yet of the given frames of a view, in one pass over its pictures."""
        wanted = sorted({int(n) for n in numbers} & {int(n) for n in self._pictures.numbers(view)})
        new = [n for n in wanted if self._key(view, n) not in self._known]
        for number, picture in zip(new, self._pictures.read(view, new) if new else (), strict=True):
            self.see(view, number, to_display(picture))

    def see(self, view: int, number: int, shown: np.ndarray) -> None:
        """Estimate the joints of one picture [h, w, 3] uint8 that somebody has read, unless they are known."""
        key = self._key(view, number)
        if key not in self._known:
            self._known[key] = np.asarray(self._turned[view].find(shown, PEOPLE).joints, dtype=np.float64)
        while len(self._known) > KEPT:
            self._known.popitem(last=False)

    def _key(self, view: int, number: int) -> str:
        """What a picture's joints are kept under: the picture, and how it was turned."""
        return f"{self._pictures.identity(view, number)} {self._turned[view].quarters}"

    @property
    def _known(self) -> OrderedDict[str, np.ndarray]:
        return self._kept.setdefault(self._estimator, OrderedDict())


def joint_reader(inputs: Inputs) -> JointReader:
    """The 2D joints of a capture that has some, given or estimated."""
    if ESTIMATED not in inputs.facts:
        return inputs.source("joints")
    return EstimatedJoints(inputs.source("pictures"), inputs.source("estimator"), inputs.rig)
