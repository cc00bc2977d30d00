"""Declaration of the pose stage."""

from __future__ import annotations

from posegaussian.stages.contract.declaration import Read, Resources, Stage, Typical
from posegaussian.stages.contract.facts import ESTIMATED, JOINTS2D, JOINTS3D, SEGMENTED, TRACKED, Facts
from posegaussian.stages.imaging.calibration import CALIBRATION_CORRECTION
from posegaussian.stages.imaging.pixel_effects import CROP_SCALE, UNDISTORTION
from posegaussian.stages.pose.effects import POSE_HEATMAPS
from posegaussian.stages.pose.params import PoseParams, halo, uses_model_maps
from posegaussian.storage.model.spec import ArraySpec, Shape


def needs(shape: Shape, params: PoseParams) -> Resources:
    """One view's partition of heatmaps, in float32 while it is drawn."""
    return Resources(cpu=1, ram=shape["frame"] * 17 * shape["y"] * shape["x"] // 16 * 12)


def unneeded(params: PoseParams, facts: Facts) -> str | None:
    """Without joints of any kind there is nothing to encode."""
    return None if {JOINTS2D, JOINTS3D} & facts else "the capture has no joints, and none are estimated"


STAGE = Stage(
    name="pose",
    summary="Triangulate joints across views, mend swapped sides and gaps over time, encode heatmaps.",
    version=6,
    run="posegaussian.stages.pose.run:run",
    check="posegaussian.stages.pose.run:check",
    reads=(
        Read.source("joints", views="sources", when=lambda p, f: JOINTS2D in f and ESTIMATED not in f, halo=halo),
        Read("detection/joints2d", when=lambda p, f: bool(f & {ESTIMATED, SEGMENTED}), halo=halo),
        Read("people/number", when=lambda p, f: TRACKED in f, halo=halo),
        Read("tracks/choice", when=lambda p, f: TRACKED in f),
        Read("detection/region", when=lambda p, f: uses_model_maps(p, f) or SEGMENTED in f),
        Read("detection/person", when=lambda p, f: SEGMENTED in f),
        Read("detection/heatmaps", when=uses_model_maps),
        Read.source("joints3d", when=lambda p, f: JOINTS3D in f),
    ),
    writes=(
        ArraySpec(
            "pose/joints2d",
            ("frame", "view", "joint", "uvs"),
            "float32",
            "px",
            "Joints in frames/* pixels and their score; 0 score = unknown.",
        ),
        ArraySpec(
            "pose/joints3d",
            ("frame", "joint", "xyzs"),
            "float32",
            "m",
            "Joints in the world and their score; 0 score = unknown.",
        ),
        ArraySpec(
            "pose/others3d",
            ("frame", "candidate", "joint", "xyzs"),
            "float32",
            "m",
            "Joints in the world of everybody else who is followed, by their number, and their score; 0 score ="
            " unknown, as are the subject's here.",
            when=TRACKED,
        ),
        ArraySpec(
            "pose/heatmaps",
            ("frame", "view", "coco17", "y/4", "x/4"),
            "float16",
            "1",
            "Peak of height score at each COCO-17 joint; cell j covers pixels [4j, 4j+4).",
            keep="until_done",
            when=POSE_HEATMAPS.name,
        ),
        ArraySpec(
            "pose/chosen",
            ("frame", "view"),
            "int32",
            "1",
            "Which of the people of detection/* is the subject, by their joints or else by who is segmented where the"
            " joints in space are seen; -1: none of them, -2: none, and somebody else hides the subject.",
            when=SEGMENTED,
        ),
        ArraySpec(
            "pose/alone",
            ("frame", "one"),
            "uint8",
            "1",
            "1 in frames in which nobody but the subject is followed, and nobody hides the subject, else 0.",
            when=SEGMENTED,
        ),
    ),
    over=("sequence", "time"),
    params=PoseParams,
    needs=needs,
    typical=Typical(seconds=1e-7, ratio=0.1),
    unneeded=unneeded,
    effects=(UNDISTORTION, CROP_SCALE, CALIBRATION_CORRECTION, POSE_HEATMAPS),
    timed=True,
)
