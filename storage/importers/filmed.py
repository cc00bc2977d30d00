"""From data sets that say how each camera stands and which files it filmed to a capture: from there on all are alike.

Their conventions are known, so what does not fit them is a damaged or changed download: cameras that look away from one
another's scene, stand a thousandth of a metre apart, or whose intrinsics are for pictures of another size.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from posegaussian.storage.importers.cameras import RawCamera, build_rig, check_principal_point
from posegaussian.storage.importers.common import ImportOptions
from posegaussian.storage.importers.evidence import check_direction
from posegaussian.storage.importers.masks import mask_file_streams
from posegaussian.storage.importers.posed_pictures import Files, picture_streams
from posegaussian.storage.model.cameras import Rig, distances
from posegaussian.storage.model.capture import Capture
from posegaussian.storage.model.errors import CalibrationError
from posegaussian.storage.model.plausible import APART


@dataclass(frozen=True, eq=False)
class Filmed:
    """One camera and its files."""

    camera: RawCamera
    """World to camera, metres."""
    pictures: Files
    """Pictures by source frame number, or a video."""
    masks: Mapping[int, Path] = field(default_factory=dict)
    """Masks by source frame number; may be empty."""


@dataclass(frozen=True)
class DataSet:
    """What is alike in all captures of a data set."""

    name: str
    """The importer's."""
    frame_rate: float
    """Frames per second of its pictures."""
    unit: str
    """Unit of its cameras' places in the files, for sentences."""
    direction: str
    """Direction of the poses in its files, for sentences."""
    rate_told: bool = False
    """Whether its authors tell the frame rate; else it is assumed, and that is said."""
    labels: bool = False
    """Whether masks hold labels of body parts: everything but 0 is the person."""


def capture_of(
    of: DataSet,
    filmed: Sequence[Filmed],
    options: ImportOptions,
    held_out: Sequence[str] = (),
    notes: Sequence[str] = (),
) -> Capture:
    """The capture of a data set's cameras, which put pixel centres at integers.

    Raises SourceError or CalibrationError, each a sentence with the next step: for files that cannot be read, and for
    cameras that are not as the data set has them.
    """
    found = {f.camera.name: f for f in filmed}
    if len(found) < len(filmed):
        given = [f.camera.name for f in filmed]
        raise CalibrationError(f"camera {next(n for n in given if given.count(n) > 1)} occurs twice; names are unique")
    names = options.pick(tuple(found))
    chosen = [found[n] for n in names]
    own_rate = options
    if not any(isinstance(f.pictures, Path) for f in chosen):  # videos say theirs
        own_rate = options.model_copy(update={"frame_rate": options.frame_rate or of.frame_rate})
        if options.frame_rate is None and not of.rate_told:
            notes = [*notes, assumed_rate(of.frame_rate)]
    pictures, rate, more = picture_streams({n: found[n].pictures for n in names}, own_rate)
    for f, stream in zip(chosen, pictures, strict=True):
        check_principal_point(f"camera {f.camera.name}", f.camera.intrinsics, f.camera.size, stream.size)
    rig = build_rig([f.camera for f in chosen], [s.size for s in pictures], half=False)
    placed = placed_notes(rig, of.unit, of.direction)
    masks, mask_notes = mask_file_streams(names, [f.masks for f in chosen], pictures, labels=of.labels)
    return Capture(
        of.name,
        rig,
        rate,
        tuple(pictures),
        masks=masks,
        held_out=tuple(n for n in names if n in held_out),
        notes=(*notes, *placed, *more, *mask_notes),
    )


def assumed_rate(rate: float) -> str:
    """The sentence about a frame rate that no file says."""
    return f"{rate:g} frames/s are assumed; where it is another, set the option frame_rate"


def placed_notes(rig: Rig, unit: str, direction: str) -> list[str]:
    """Sentences on the unit and the direction that a rig, metres and world to camera, was read with.

    Raises CalibrationError where cameras lie nearer or farther from one another than those of a rig do, or look past
    one another.
    """
    apart = distances(rig.centres)
    if len(apart) and not APART[0] <= apart[-1] <= APART[1]:
        raise CalibrationError(
            f"cameras lie up to {apart[-1]:.4g} m apart where the files' unit is {unit}, as the layout has it;"
            f" {APART[0]:g} to {APART[1]:g} m are plausible. Were the places converted to another unit? Take the files"
            " as they were downloaded"
        )
    facing = check_direction(rig.names, np.asarray(rig.rotations), np.asarray(rig.centres), direction)
    return [f"unit: {unit}, as the layout has it", *facing]
