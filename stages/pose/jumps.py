"""Where the subject jumps: in a frame and a camera it is then somebody or something else that was followed."""

from __future__ import annotations

import numpy as np

from posegaussian.stages.contract.io import Inputs
from posegaussian.stages.following.nearness import apart, extent
from posegaussian.storage.model.joint_sets import to_set

STILL, SPEED = 0.35, 3.0
"""Body extents, and those a second, that a person moves in a picture from one frame to the next: a runner who crosses
it. A joint's noise is far below."""
FEWEST = 6
"""Joints that a detection must have to be compared with the one before."""
SHOWN = 6
"""Jumps that are named; the rest is counted."""


def jumps(seen: np.ndarray, times: np.ndarray, set_id: str, own: range, reach: int) -> list[tuple[int, int, float]]:
    """(frame from the first of `own`, view, body extents) of jumps in some frames of joints [F, V, J, 3] px; left and
    right do not count, and a frame is compared with the last one in which the view saw the subject.

    own: indices of the frames that are judged; reach: frames that are looked back; times [F] seconds.
    """
    joints = to_set(seen, set_id, "coco17")
    found = []
    for f in own:
        for v in np.flatnonzero((joints[f, ..., 2] > 0).sum(axis=-1) >= FEWEST):
            before = next(
                (b for b in range(f - 1, max(f - reach, 0) - 1, -1) if (joints[b, v, :, 2] > 0).sum() >= FEWEST), None
            )
            if before is None:
                continue
            size = max(extent(joints[f, v]), extent(joints[before, v]), 1e-9)
            off = apart(joints[before, v], joints[f, v]) / size
            if np.isfinite(off) and off > STILL + SPEED * float(times[f] - times[before]):
                found.append((f - own.start, int(v), off))
    return found


def jumps_told(found: list[tuple[int, int, float]], inputs: Inputs) -> tuple[str, ...]:
    """A sentence on where the subject jumps, by source frame and camera; none where it does not."""
    if not found:
        return ()
    each = ", ".join(
        f"frame {inputs.source_frames[f]} in {inputs.views.names[v]} by {off:.1f}" for f, v, off in found[:SHOWN]
    )
    more = f", and {len(found) - SHOWN} more" if len(found) > SHOWN else ""
    return (
        (
            f"the subject jumps, in heights of a body: {each}{more}; somebody else may have been taken for it there"
            " (pose.subject, detection.box)"
        ),
    )
