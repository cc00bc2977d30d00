"""What every import says, whatever the layout: unit, direction, distances between cameras, captured against calibrated
size, frames that some cameras lack or show twice, and pictures that use few of their bits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from posegaussian.storage.importers.cameras import of_another_size, rig_notes
from posegaussian.storage.importers.common import picture_gaps
from posegaussian.storage.importers.evidence import check_direction
from posegaussian.storage.model.capture import Capture
from posegaussian.storage.readers import images

_LOOKED_AT = 8
"""Pictures whose largest value is looked at, each of another camera."""
_RUNS = 4
"""Runs of one picture that are named of a camera."""
_BITS = (8, 10, 12)
"""Bits of cameras that write files of 16."""
DIRECTION = "world to camera"
"""Of the poses in layouts that define it."""


def accounted(capture: Capture, by_definition: bool) -> Capture:
    """The capture with these sentences after its own.

    With `by_definition` the layout defines metres and world to camera, and its importer says nothing of it, or the unit
    alone where the user says one. Raises CalibrationError where the cameras' poses are those of the other direction.
    """
    rig = capture.rig
    placed: list[str] = []
    if by_definition:
        told = any(n.startswith("unit: ") for n in capture.notes)
        placed = [] if told else ["unit: metres, as the layout has it"]
        placed += check_direction(rig.names, np.asarray(rig.rotations), np.asarray(rig.centres), DIRECTION)
    gaps = picture_gaps(rig.names, capture.pictures)
    notes = (
        *capture.notes,
        *placed,
        *rig_notes(rig),
        *_sizes(capture),
        *gaps,
        *_repeats(capture),
        *_one_frame_apart(capture),
        *_few_bits(capture),
    )
    return replace(capture, notes=notes)


def _sizes(capture: Capture) -> list[str]:
    """A sentence on the cameras whose pictures have the calibrated size; those with another size have their own."""
    rig = capture.rig
    same = [v for v, s in enumerate(capture.pictures) if tuple(s.size) == tuple(rig.size[v].tolist())]
    if not same:
        return []
    sizes = sorted({capture.pictures[v].size for v in same})
    listed = ", ".join(f"{w}x{h}" for w, h in sizes[:4]) + (", ..." if len(sizes) > 4 else "")
    off = np.abs(rig.intrinsics[same][:, [0, 1], 2] / rig.size[same] - 0.5)
    which = "all cameras" if len(same) == len(rig) else f"{len(same)} of {len(rig)} cameras"
    told = f"{which}: captured at the calibrated size, {listed} px (scale 1)"
    far = [rig.names[v] for v in same if of_another_size(rig.intrinsics[v], rig.size[v])]
    doubt = f", in {', '.join(far[:4])} as if the intrinsics were for pictures of another size" if far else ""
    return [f"{told}; principal points lie up to {100 * off.max():.2g} % of a side off the middle{doubt}"]


def _one_frame_apart(capture: Capture) -> list[str]:
    """A sentence where videos differ by one frame in length: which end it is lacking at, they do not tell."""
    videos = [s for s in capture.pictures if s.kind == "video" and "indices" not in s.options]
    lengths = [len(s.numbers) for s in videos]
    if not lengths or len({s.numbers[0] for s in videos}) > 1 or max(lengths) - min(lengths) != 1:
        return []
    told = f"videos have {min(lengths)} and {max(lengths)} frames and are taken to begin together"
    late = "where it is the first frame that is lacking, `inspect` shows who is late, and frames.time_offset moves them"
    return [f"{told}; {late}"]


def _repeats(capture: Capture) -> list[str]:
    """A sentence on every camera whose files of pictures stay the same while those of others change."""
    notes = []
    for name, runs in zip(capture.rig.names, capture.repeats(capture.numbers), strict=True):
        if runs:
            listed = ", ".join(f"frames {a} to {b}" for a, b in runs[:_RUNS]) + ", ..." * (len(runs) > _RUNS)
            notes.append(
                f"{name}: {listed} show the same picture, while other cameras' change: did its recording stand still?"
                " Give it the right pictures, or leave it out with --option cameras or views.sources"
            )
    return notes


def _few_bits(capture: Capture) -> list[str]:
    """A sentence where 16-bit pictures use the lowest bits alone, as cameras of 10 or 12 bits write them: to whoever
    takes 65535 for white they are nearly black."""
    files = [s.files[len(s.files) // 2].path for s in capture.pictures if s.kind == "images"]
    some = files[:: max(1, len(files) // _LOOKED_AT)][:_LOOKED_AT]
    most = max((n for p in some if (n := images.largest_of_16_bits(p)) is not None), default=0)
    bits = next((b for b in _BITS if 0 < most < 2**b), None)
    if bits is None:
        return []
    factor = 2 ** (16 - bits)
    told = f"16-bit pictures hold at most {most} where looked at: {bits} bits in 16, which is {factor} times too dark"
    return [f"{told}; multiply them by {factor} and import again"]
