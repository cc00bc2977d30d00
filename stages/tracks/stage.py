"""Declaration of the tracks stage."""

from __future__ import annotations

from posegaussian.stages.contract.declaration import Read, Resources, Stage, Typical, Unit
from posegaussian.stages.contract.facts import ESTIMATED, TRACKED, Facts
from posegaussian.stages.imaging.calibration import CALIBRATION_CORRECTION
from posegaussian.stages.imaging.camera_mapping import frames_rig
from posegaussian.stages.imaging.pixel_effects import CROP_SCALE, UNDISTORTION
from posegaussian.stages.tracks.params import LONGEST, TracksParams
from posegaussian.storage.model.spec import ArraySpec, Shape


def needs(shape: Shape, params: TracksParams) -> Resources:
    """Numbers of all detections of the sequence, one block of joints, and a few pictures."""
    seen = shape["moment"] * shape["view"] * 16
    return Resources(
        cpu=1, ram=16 * seen + 1024 * shape["view"] * 16 * 33 * 24 + shape["source_y"] * shape["source_x"] * 30
    )


def unneeded(params: TracksParams, facts: Facts) -> str | None:
    """With one person a picture there is nobody to mistake."""
    return (
        None if TRACKED in facts else "joints that came with the capture name one person a picture, or there are none"
    )


STAGE = Stage(
    name="tracks",
    summary="Follow everybody through the whole sequence, across views and over time.",
    version=4,
    run="posegaussian.stages.tracks.run:run",
    reads=(
        Read("detection/joints2d", when=lambda p, f: ESTIMATED in f),
        Read.source("joints", views="sources", when=lambda p, f: ESTIMATED not in f),
        Read.source("pictures", views="sources"),
    ),
    writes=(
        ArraySpec(
            "tracks/people",
            ("moment", "other_view", "candidate"),
            "int16",
            "1",
            "Who each person found in a picture is: 0 is person1; -1 nobody who is followed.",
        ),
        ArraySpec(
            "tracks/about",
            ("candidate", "person_fact"),
            "float32",
            "1",
            "Of each person: shares of frames and pictures, span in them, x, y, z, size, distance from the middle;"
            " all 0 = nobody.",
        ),
        ArraySpec(
            "tracks/choice",
            ("choice",),
            "int16",
            "1",
            "The largest person, the central one, and how many there are; -1 = nobody.",
        ),
    ),
    over=("sequence",),
    params=TracksParams,
    needs=needs,
    typical=Typical(seconds=5e-9, ratio=0.4),
    unit=Unit(worked=0, captured=1),
    unneeded=unneeded,
    effects=(UNDISTORTION, CROP_SCALE, CALIBRATION_CORRECTION),
    cameras=lambda rig, params: frames_rig(rig, LONGEST),
    timed=True,
)
