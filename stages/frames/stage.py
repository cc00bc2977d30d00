"""Declaration of the frames stage."""

from __future__ import annotations

from collections.abc import Iterator

from posegaussian.stages.contract.declaration import Choice, Evidence, Read, Resources, Stage, Typical, Unit
from posegaussian.stages.contract.facts import (
    BLAZEPOSE,
    GIVEN_DEPTH,
    JOINTS2D,
    JOINTS3D,
    LINEAR_LIGHT,
    MASKS,
    SEGMENTED,
    SEVERAL_FRAMES,
    TRACKED,
    TRUTH_DEPTH,
    Facts,
)
from posegaussian.stages.contract.io import Views
from posegaussian.stages.contract.judged import MATTES, SHARED_LIGHT
from posegaussian.stages.detection.params import ADDED
from posegaussian.stages.frames.effects import (
    EXPOSURE_MATCHING,
    GAP_OPENING,
    LIGHT_STEADYING,
    NOISE_AVERAGING,
    OUTLINE_CORRECTION,
    OUTLINE_REDRAWING,
    TONE_MAPPING,
)
from posegaussian.stages.frames.exposures import SURFACE, compared
from posegaussian.stages.frames.facts import AVERAGED_WITH
from posegaussian.stages.frames.params import (
    FramesParams,
    better_matte,
    matte_choice,
    resolve_matte,
    wants_segmentation,
)
from posegaussian.stages.imaging.calibration import CALIBRATION_CORRECTION
from posegaussian.stages.imaging.camera_mapping import frames_rig
from posegaussian.stages.imaging.pixel_effects import CROP_SCALE, UNDISTORTION, undistorted_as_set
from posegaussian.storage.model.capture import Capture
from posegaussian.storage.model.spec import ArraySpec, Shape


def needs(shape: Shape, params: FramesParams) -> Resources:
    """One view's partition of pictures, masks and depth, where each pixel lies in the captured picture, and one of
    these while it is warped, pictures around it while it is averaged; the colours of one picture where a person is cut
    out, gaps of a mask are looked for or its outlines redrawn, and for a person all views' segmentations."""
    pictures, captured = (
        shape["frame"] * shape["y"] * shape["x"] * 16 + shape["y"] * shape["x"] * (20 + 6 * AVERAGED_WITH + 60),
        shape["source_y"] * shape["source_x"] * 60,
    )
    colors = shape["y"] * shape["x"] * 160 if params.matte in ("auto", "given", "person") else 0
    person = shape["frame"] * shape["view"] * shape["person"] * 2**16 if params.matte in ("auto", "person") else 0
    return Resources(cpu=1, ram=pictures + captured + colors + person)


def _given(params: FramesParams, facts: Facts) -> bool:
    return resolve_matte(params, facts) == "given"


def _plate(params: FramesParams, facts: Facts) -> bool:
    matte = resolve_matte(params, facts)
    return matte == "plate" or (matte == "person" and SEVERAL_FRAMES in facts)


def _person(params: FramesParams, facts: Facts) -> bool:
    return resolve_matte(params, facts) == "person"


def _segmented(params: FramesParams, facts: Facts) -> bool:
    return SEGMENTED in facts and _person(params, facts)


def _matched(params: FramesParams, facts: Facts) -> bool:
    return EXPOSURE_MATCHING.name in facts


def _corrected(params: FramesParams, facts: Facts) -> bool:
    return OUTLINE_CORRECTION.name in facts and _given(params, facts)


def _opened(params: FramesParams, facts: Facts) -> bool:
    return {GAP_OPENING.name, JOINTS2D} <= facts and _given(params, facts)


def _tone_mapped(params: FramesParams, facts: Facts) -> bool:
    return TONE_MAPPING.name in facts


def _averaged(params: FramesParams, facts: Facts) -> bool:
    return NOISE_AVERAGING.name in facts


def halo(params: FramesParams, facts: Facts) -> tuple[int, int]:
    """Frames around the partition whose pictures are averaged with its own."""
    return (AVERAGED_WITH, AVERAGED_WITH) if _averaged(params, facts) else (0, 0)


def _truth(params: FramesParams, facts: Facts) -> bool:
    return TRUTH_DEPTH in facts


def refusal(params: FramesParams, facts: Facts) -> str | None:
    """Given masks must have come with the capture; a person needs joints, a plate frames to take a median of."""
    if params.matte == "given" and MASKS not in facts:
        return "frames.matte is given, but not every source view has masks; use auto, person, plate or none"
    if params.matte == "person" and not {JOINTS2D, JOINTS3D} & facts:
        return (
            "frames.matte is person, but there are no joints to find the person by:"
            f" set detection.estimator to blazepose ({ADDED}) or to onnx with a model of yours, or import joints;"
            " or use plate or none"
        )
    if params.matte == "plate" and SEVERAL_FRAMES not in facts:
        return "frames.matte is plate, but the capture has a single frame; use given or none"
    return None


def told_facts(capture: Capture, views: Views, params: FramesParams, known: Facts) -> Iterator[str]:
    """What the pictures are and came with, and whether an estimator segments the person in them."""
    worked = (*views.sources, *views.held_out)

    def every(kind: str) -> bool:
        streams = capture.streams(kind)
        return bool(streams) and all(streams[v] is not None for v in worked)

    exr = any(f.path.lower().endswith(".exr") for v in views.sources for f in capture.pictures[v].files)
    given = bool(capture.depth_maps) and all(capture.depth_maps[v] is not None for v in views.sources)
    holds = {
        MASKS: every("masks"),
        TRUTH_DEPTH: every("depth"),
        GIVEN_DEPTH: given,
        SEVERAL_FRAMES: len(capture.numbers) > 1,
        LINEAR_LIGHT: exr,
    }
    found = {name for name, held in holds.items() if held}
    yield from found
    matte = resolve_matte(params, known | found)
    if matte in MATTES and refusal(params, known | found) is None:
        yield MATTES[matte]
    if BLAZEPOSE in known and wants_segmentation(params, known | found):
        yield SEGMENTED


def notes(evidence: Evidence) -> list[str]:
    """What would make a better matte."""
    better = better_matte(evidence.params, evidence.facts)
    return [] if better is None else [better]


STAGE = Stage(
    name="frames",
    summary="Decode, crop, undistort and scale the pictures, and find the foreground.",
    version=7,
    run="posegaussian.stages.frames.run:run",
    check="posegaussian.stages.frames.run:check",
    reads=(
        Read.source("pictures", halo=halo),
        Read("survey/unrest", views="own", when=_averaged),
        Read.source("masks", when=_given),
        Read.source("depth", when=_truth),
        Read.source("depth_maps", when=lambda p, f: GIVEN_DEPTH in f),
        Read("survey/plate", views="own", when=_plate),
        Read("survey/spread", views="own", when=_plate),
        Read("detection/person", when=_segmented),
        Read("detection/region", when=_segmented),
        Read("pose/chosen", when=_segmented),
        Read("pose/alone", when=_segmented),
        Read("pose/joints2d", views="own", when=lambda p, f: _person(p, f) or _opened(p, f)),
        Read("pose/joints3d", when=_person),
        Read("pose/others3d", when=lambda p, f: TRACKED in f and _person(p, f)),
        Read(SURFACE, views="sources", when=lambda p, f: _matched(p, f) and compared(f) == SURFACE),
        Read(SHARED_LIGHT, when=lambda p, f: _matched(p, f) and compared(f) == SHARED_LIGHT),
        Read("survey/outlines", views="own", when=_corrected),
        Read("survey/light", views="sources", when=_tone_mapped),
    ),
    writes=(
        ArraySpec(
            "frames/color",
            ("frame", "view", "y", "x", "rgb"),
            "uint8",
            "sRGB",
            "Picture after crop, undistortion and scaling; padding is black.",
            keep="until_done",
        ),
        ArraySpec(
            "frames/mask",
            ("frame", "view", "y", "x"),
            "uint8",
            "1/255",
            "Soft foreground of the one main subject; padding is 0.",
        ),
        ArraySpec(
            "truth/depth",
            ("frame", "view", "y", "x"),
            "float32",
            "m",
            "True depth along the optical axis of a simulated capture; 0 where there is no surface.",
            when=TRUTH_DEPTH,
        ),
        ArraySpec(
            "frames/depth",
            ("frame", "view", "y", "x"),
            "float32",
            "m",
            "Depth along the optical axis as given with the capture; 0 where there is none.",
            keep="until_done",
            when=GIVEN_DEPTH,
        ),
    ),
    over=("sequence", "time", "view"),
    params=FramesParams,
    needs=needs,
    typical=Typical(seconds=5e-7, ratio=0.75),
    unit=Unit(worked=1, captured=0.1),
    refusal=refusal,
    effects=(
        UNDISTORTION,
        CROP_SCALE,
        CALIBRATION_CORRECTION,
        LIGHT_STEADYING,
        NOISE_AVERAGING,
        EXPOSURE_MATCHING,
        OUTLINE_REDRAWING,
        OUTLINE_CORRECTION,
        GAP_OPENING,
        TONE_MAPPING,
    ),
    choices=(Choice("matte", matte_choice),),
    undistorted=undistorted_as_set,
    cameras=lambda rig, params: frames_rig(rig, params.size),
    facts=told_facts,
    notes=notes,
)
