"""Declaration of the detection stage."""

from __future__ import annotations

from posegaussian.stages.contract.declaration import Choice, Read, Resources, Stage, Typical, Unit
from posegaussian.stages.contract.facts import ESTIMATED, SEGMENTED, Facts
from posegaussian.stages.detection.asset import ESTIMATOR, joint_set, named_joint_set, settled, told_facts
from posegaussian.stages.detection.params import DetectionParams, estimator_choice, refusal
from posegaussian.stages.imaging.calibration import CALIBRATION_CORRECTION
from posegaussian.stages.imaging.pixel_effects import CROP_SCALE, UNDISTORTION
from posegaussian.storage.model.joint_sets import JOINT_SETS
from posegaussian.storage.model.spec import ArraySpec, Shape


def needs(shape: Shape, params: DetectionParams) -> Resources:
    """A few captured pictures, the models, and what is found in all views of a partition."""
    found = shape["frame"] * shape["view"] * params.people * (17 * 64 * 64 * 2 + 256 * 256)
    return Resources(cpu=1, ram=shape["source_y"] * shape["source_x"] * 30 + 2 * found + 2**28)


def unneeded(params: DetectionParams, facts: Facts) -> str | None:
    """Joints that came with the capture, or none at all, and no matte that a segmentation would help."""
    return None if facts & {ESTIMATED, SEGMENTED} else estimator_choice(params, facts)[1]


def dimensions(params: DetectionParams, facts: Facts) -> dict[str, int]:
    """How many people are kept, and the joints of who finds them."""
    found = {"person": params.people}
    if facts & {ESTIMATED, SEGMENTED}:
        found["found_joint"] = len(JOINT_SETS[named_joint_set(settled(params, facts))].names)
    return found


STAGE = Stage(
    name="detection",
    summary="Find people and their joints in the pictures, and look again where a view missed the subject.",
    version=3,
    run="posegaussian.stages.detection.run:run",
    check="posegaussian.stages.detection.run:check",
    reads=(Read.source("pictures", views="sources"), Read.source("estimator")),
    writes=(
        ArraySpec(
            "detection/joints2d",
            ("frame", "view", "person", "found_joint", "uvs"),
            "float32",
            "px",
            "Joints of everybody found, in captured pixels, and their score; all 0 = nobody.",
        ),
        ArraySpec(
            "detection/region",
            ("frame", "view", "person", "region"),
            "float32",
            "px",
            "Square in which a person was looked at: centre u, v, side in captured pixels, turn in radians;"
            " side 0 = nobody.",
        ),
        ArraySpec(
            "detection/heatmaps",
            ("frame", "view", "person", "coco17", "map_y", "map_x"),
            "float16",
            "1",
            "The estimator's heatmaps over the region, 0..1; not kept where joints came with the capture.",
            keep="until_done",
            when=ESTIMATED,
        ),
        ArraySpec(
            "detection/person",
            ("frame", "view", "person", "hint_y", "hint_x"),
            "uint8",
            "1/255",
            "The estimator's segmentation of the person over the region; 0 where it gives none.",
            keep="until_done",
        ),
    ),
    over=("sequence", "time"),
    params=DetectionParams,
    needs=needs,
    typical=Typical(seconds=6e-8, ratio=0.2),
    unit=Unit(worked=0, captured=1),
    unneeded=unneeded,
    refusal=refusal,
    effects=(UNDISTORTION, CROP_SCALE, CALIBRATION_CORRECTION),
    choices=(Choice("estimator", estimator_choice),),
    facts=told_facts,
    joint_set=joint_set,
    dimensions=dimensions,
    assets=(ESTIMATOR,),
)
