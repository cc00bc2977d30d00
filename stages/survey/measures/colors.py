"""Colours of patches of the body that several cameras see alike."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from posegaussian.stages.contract.facts import JOINTS2D, JOINTS3D
from posegaussian.stages.contract.io import Block
from posegaussian.stages.survey.algorithms.look import NO_FRAMES, Look
from posegaussian.stages.survey.measures.declaration import Measure, Sampled, of
from posegaussian.storage.model.spec import ArraySpec

NAME = "survey/colors"


class ColorsLook(Look):
    """[192, 3] float32 of one view: `patches.typical_colors`; zeros of a view that is no source, or without joints."""

    def __init__(self, s: Sampled) -> None:
        """Of every sampled frame."""
        from posegaussian.stages.survey.algorithms.patches import PATCHES

        known = JOINTS2D in s.inputs.facts or JOINTS3D in s.inputs.facts
        self.numbers = s.if_source(s.chosen) if known else NO_FRAMES
        self.joints_of_all = s.chosen
        self._inputs, self._view = s.inputs, s.view
        self._samples = np.zeros((len(self.numbers), PATCHES, 3))

    def see(self, number: int, picture: np.ndarray, shown: np.ndarray) -> None:
        """Colours of the patches in one frame."""
        from posegaussian.stages.survey.algorithms.joints import joints_in_space
        from posegaussian.stages.survey.algorithms.patches import patch_colors

        i, inputs = int(np.searchsorted(self.numbers, number)), self._inputs
        space = joints_in_space(inputs, number)
        self._samples[i] = patch_colors(
            shown, space, inputs.rig, inputs.source_rig, inputs.captured_to_calibrated, self._view
        )

    def blocks(self) -> Iterator[Block]:
        """The colours."""
        from posegaussian.stages.survey.algorithms.patches import typical_colors

        empty = np.zeros(self._samples.shape[1:], np.float32)
        yield Block(NAME, typical_colors(self._samples) if len(self._samples) else empty, self._view)


MEASURE = Measure(
    (
        ArraySpec(
            NAME,
            ("view", "patch", "rgb"),
            "float32",
            "linear light",
            "Median colour of 192 patches of the body, the same in every source view (12 joints x 16 directions), 0..1;"
            " 0 where not seen.",
            when=NAME,
            noted=True,
        ),
    ),
    ColorsLook,
    of("joints2d", "joints3d"),
)
