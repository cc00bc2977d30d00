"""The background plate of a static camera, and how far its pictures differ from it."""

from __future__ import annotations

import numpy as np

from posegaussian.stages.contract.facts import JOINTS2D
from posegaussian.stages.contract.io import Block
from posegaussian.stages.survey.algorithms.look import Look
from posegaussian.stages.survey.measures.declaration import Measure, Sampled, Source, SurveySettings
from posegaussian.storage.model.spec import ArraySpec

UNSTEADY = 12.0
"""Median spread of a whole picture, 1/255, above which camera or light are not static."""


def _look(s: Sampled) -> Look:
    from posegaussian.stages.detection.reader import joint_reader
    from posegaussian.stages.survey.algorithms.plate import PlateLook
    from posegaussian.stages.survey.algorithms.sample import sample_numbers

    joints = joint_reader(s.inputs) if JOINTS2D in s.inputs.facts and s.params.joints_margin > 0 else None
    numbers = sample_numbers(s.numbers, s.params.sample)
    return PlateLook(s.inputs, s.view, numbers, s.chosen, s.params.sample, joints, s.params.joints_margin)


def _sources(params: SurveySettings) -> frozenset[Source]:
    return frozenset({"joints2d"}) if params.joints_margin > 0 else frozenset()


def _check(block: Block) -> list[str]:
    """A warning about pictures that are not static."""
    from posegaussian.stages.survey.algorithms.plate import UNKNOWN

    if block.array != "survey/spread":
        return []
    # A smaller view's padding, zeros to the right and below, is no part of its picture; pixels that never change are.
    rows, columns = np.nonzero(block.data)
    shown = block.data[: rows.max(initial=-1) + 1, : columns.max(initial=-1) + 1]
    known = shown[shown < UNKNOWN]
    typical = float(np.median(known)) if len(known) else 0.0
    if typical <= UNSTEADY:
        return []
    return [
        (
            f"view {block.view}: colours differ by {typical:.0f}/255 between frames all over the picture (bound"
            f" {UNSTEADY:.0f}); the camera or the light is not static, do not use frames.matte: plate"
        )
    ]


MEASURE = Measure(
    (
        ArraySpec(
            "survey/background",
            ("view", "sample"),
            "int64",
            "1",
            "Source frame numbers whose median is the plate; -1 pads.",
            when="survey/plate",
        ),
        ArraySpec(
            "survey/plate",
            ("view", "source_y", "source_x", "rgb"),
            "uint8",
            "sRGB",
            "Median colour of its frames, people left out where joints tell, in the light of those that are worked on:"
            " the background of a static camera, in captured pixels.",
            when="survey/plate",
        ),
        ArraySpec(
            "survey/spread",
            ("view", "source_y", "source_x"),
            "uint8",
            "1/255",
            "Median absolute deviation from the plate, largest of the three channels; 255: a person covered the pixel"
            " in nearly every frame.",
            when="survey/spread",
        ),
        ArraySpec(
            "survey/drift",
            ("view", "sample", "rgb"),
            "float64",
            "stops",
            "By how much each sampled picture is brighter than these usually are, where it shows the background; 99"
            " where that cannot be told.",
            when="survey/drift",
            noted=True,
        ),
    ),
    _look,
    _sources,
    _check,
)
