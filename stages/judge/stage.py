"""Declaration of the judge stage."""

from __future__ import annotations

from posegaussian.stages.contract.declaration import Read, Resources, Stage, Typical, Unit
from posegaussian.stages.contract.facts import ESTIMATED, JOINTS2D, JOINTS3D, SEGMENTED, SEVERAL_FRAMES, Facts
from posegaussian.stages.contract.judged import (
    CALIBRATION,
    DEPTH,
    EXPOSURE,
    GIVEN_MATTE,
    LEARNED,
    MATTES,
    NO_MATTE,
    PERSON_MATTE,
    PLATE_MATTE,
    POSE,
    SHARED_LIGHT,
    TURNS,
)
from posegaussian.stages.depth.methods.registry import BY_PICTURES
from posegaussian.stages.frames.effects import LIGHT_STEADYING
from posegaussian.stages.frames.exposures import SURFACE
from posegaussian.stages.imaging.camera_mapping import frames_rig
from posegaussian.stages.imaging.small_turns import LINKS
from posegaussian.stages.judge.params import JudgeParams
from posegaussian.stages.network.asset import SHIPPED_NETWORKS
from posegaussian.stages.network.choice import CANDIDATES
from posegaussian.stages.refinement.params import RefinementParams, optimised_bytes
from posegaussian.storage.model.spec import ArraySpec, Shape


def needs(shape: Shape, params: JudgeParams) -> Resources:
    """Pictures, masks, depth and Gaussians of all views of a few reduced frames, by every candidate (48 bytes a pixel
    each), what matching one frame works in or turning cameras with the Gaussians of all of them, one captured picture
    while it is reduced, and who finds people in it."""
    sides = shape["source_y"], shape["source_x"]
    pixels = min(params.size, max(*sides, shape["y"], shape["x"])) ** 2
    each = params.frames * shape["view"] * 48 * (len(BY_PICTURES) + 2)
    worked_in = max(
        pixels * (shape["view"] * 88 + 2000), params.frames * optimised_bytes(pixels, shape["view"], RefinementParams())
    )
    return Resources(cpu=1, ram=pixels * each + worked_in + sides[0] * sides[1] * 60 + 2**28)


def _compared(params: JudgeParams, facts: Facts) -> bool:
    return SHARED_LIGHT in facts


def _turned(params: JudgeParams, facts: Facts) -> bool:
    return TURNS in facts or CALIBRATION in facts


def unneeded(params: JudgeParams, facts: Facts) -> str | None:
    """Why no picture of a left-out view can be compared, or None."""
    return None if facts & set(MATTES.values()) else NO_MATTE


def _given(params: JudgeParams, facts: Facts) -> bool:
    return GIVEN_MATTE in facts


def _plate(params: JudgeParams, facts: Facts) -> bool:
    return PLATE_MATTE in facts or {PERSON_MATTE, SEVERAL_FRAMES} <= facts


def _estimator(params: JudgeParams, facts: Facts) -> bool:
    return PERSON_MATTE in facts and bool(facts & {ESTIMATED, SEGMENTED})


def _joints(params: JudgeParams, facts: Facts) -> bool:
    return JOINTS2D in facts and bool(facts & {PERSON_MATTE, LEARNED, POSE}) and ESTIMATED not in facts


def _fit(params: JudgeParams, facts: Facts) -> bool:
    return {PERSON_MATTE, JOINTS2D} <= facts


def _joints3d(params: JudgeParams, facts: Facts) -> bool:
    return JOINTS3D in facts and (PERSON_MATTE in facts or (bool(facts & {LEARNED, POSE}) and ESTIMATED not in facts))


STAGE = Stage(
    name="judge",
    summary="Draw left-out source views from the others, choice by choice, on a few reduced frames.",
    version=13,
    run="posegaussian.stages.judge.run:run",
    reads=(
        Read.source("pictures", views="sources"),
        Read.source("masks", views="sources", when=_given),
        Read.source("estimator", when=_estimator),
        Read.source("joints", views="sources", when=_joints),
        Read.source("joints3d", when=_joints3d),
        Read("survey/joint_fit", views="sources", when=_fit),
        Read("survey/plate", views="sources", when=_plate),
        Read("survey/spread", views="sources", when=_plate),
        Read(LINKS, views="sources", when=_turned),
        Read(SURFACE, views="sources", when=_compared),
        Read.source(SHIPPED_NETWORKS.name, when=lambda p, f: LEARNED in f),
    ),
    writes=(
        ArraySpec(
            TURNS,
            ("one_view", "axis"),
            "float64",
            "rad",
            "By how much each source view stands turned against its calibration, about its own axes, so that what pairs"
            " of them share lies on each other's lines, and further with the Gaussians where that draws left-out views"
            " better; 0 of every other camera.",
            when=TURNS,
            noted=True,
        ),
        ArraySpec(
            CALIBRATION,
            ("judged", "switch", "score"),
            "float64",
            "1",
            "PSNR in dB, SSIM and coverage of pictures of left-out source views with cameras as they are written down"
            " and turned; -1 where none was drawn.",
            when=CALIBRATION,
            noted=True,
        ),
        ArraySpec(
            DEPTH,
            ("judged", "depth_method", "score"),
            "float64",
            "1",
            "PSNR in dB, SSIM and coverage of pictures of left-out source views by depth method, the worst quality"
            " level first; -1 where none was drawn.",
            when=DEPTH,
            noted=True,
        ),
        ArraySpec(
            EXPOSURE,
            ("judged", "switch", "score"),
            "float64",
            "1",
            "The same without and with exposure gains.",
            when=EXPOSURE,
            noted=True,
        ),
        ArraySpec(
            SHARED_LIGHT,
            ("one_view", "other_view", "point", "rgb"),
            "float32",
            "stops",
            "By how much a source view is brighter than each later one at points that both see, the darkest first, as"
            " features or the judge's depth show it, whichever draws left-out views better; 99 where there is none.",
            when=SHARED_LIGHT,
            noted=True,
        ),
        ArraySpec(
            POSE,
            ("judged", "switch", "score"),
            "float64",
            "1",
            "The same without and with views weighed by how sure they are of joints.",
            when=POSE,
            noted=True,
        ),
        ArraySpec(
            LEARNED,
            ("judged", "weights", "score"),
            "float64",
            "1",
            "The same without a network and with the weights that ship, by name; of those that do not fit: without.",
            when=LEARNED,
            noted=True,
        ),
    ),
    over=("sequence",),
    params=JudgeParams,
    needs=needs,
    sized_by="judge.size",
    typical=Typical(seconds=1.2e-7, ratio=0.9),
    unit=Unit(worked=0, captured=1),
    unneeded=unneeded,
    sequence_wide=True,
    cameras=lambda rig, params: frames_rig(rig, params.size),
    dimensions=lambda params, facts: {
        "judged": params.frames * params.views,
        "depth_method": len(BY_PICTURES),
        "weights": len(CANDIDATES),
    },
    effects=(LIGHT_STEADYING,),
    sees=("detection", "pose", "frames", "depth"),
)
